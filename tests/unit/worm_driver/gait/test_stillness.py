# SPDX-License-Identifier: Apache-2.0
"""Rest of the body, as the tracker measures it."""

import math
import random

import pytest

from worm_driver.gait.stillness import SPAN, Stillness

RATE_HZ = 30.0
LENGTH = 0.2952


def seen(
    length, duration: float, noise: float = 0.0, rear=lambda _: 0.1, rate_hz: float = RATE_HZ
) -> list[tuple[float, bool]]:
    """Return time and outcome of each sample of a robot whose length is a function of time."""
    draw, still, found = random.Random(1), Stillness(), []
    for index in range(round(duration * rate_hz)):
        time = index / rate_hz
        place = rear(time) + draw.gauss(0.0, noise)
        still.observe(time, place, place + length(time) + draw.gauss(0.0, noise))
        found.append((time, still.lasts))
    return found


@pytest.mark.parametrize("rate_hz", [6.5, 7.9, 15.0, 30.0, 100.0])
def test_rest_is_detected_once_the_samples_cover_a_span(rate_hz: float):
    found = seen(lambda _: LENGTH, 3.0, noise=5e-5, rate_hz=rate_hz)
    early = 0.9 * SPAN - 1.0 / rate_hz
    assert not any(lasts for time, lasts in found if time < early)
    assert all(lasts for time, lasts in found if time > SPAN)


@pytest.mark.parametrize("module", ["rear", "front"])
def test_a_module_that_appears_late_must_be_seen_for_a_span(module: str):
    """Half of a span would be enough for two means, but they would be too close to each other to show a creep."""

    def hidden(time: float) -> float:
        return math.nan if time < 1.0 else 0.0

    found = seen(
        lambda time: LENGTH + (hidden(time) if module == "front" else 0.0),
        3.0,
        rear=lambda time: 0.1 + (hidden(time) if module == "rear" else 0.0),
    )
    assert not any(lasts for time, lasts in found if time < 1.0 + 0.9 * SPAN)
    assert all(lasts for time, lasts in found if time > 1.0 + SPAN)


def test_a_body_that_creeps_is_not_mistaken_for_one_at_rest():
    """It starts 4.7 mm off, with a time constant of a second: the accepted length is within half a millimetre."""

    def creeping(time: float) -> float:
        return LENGTH - 4.7e-3 * math.exp(-time)

    first = next(time for time, lasts in seen(creeping, 6.0) if lasts)
    assert first > 2.0
    assert LENGTH - creeping(first - SPAN / 2) < 1e-3


def test_a_robot_that_slides_whole_does_not_stand():
    assert not any(lasts for _, lasts in seen(lambda _: LENGTH, 3.0, rear=lambda time: 2e-3 * time))


def test_another_clock_starts_again_and_keeps_no_more_than_a_span():
    """A virtual robot's clock begins at 0, after samples by that of the computer."""
    still = Stillness()
    for index in range(100):
        still.observe(4e4 + index / RATE_HZ, 0.1, 0.1 + LENGTH)
    still.observe(0.0, 0.2, 0.2 + LENGTH)
    assert not still.lasts
    for index in range(1, 1000):
        still.observe(index / RATE_HZ, 0.2, 0.2 + LENGTH)
    assert still.lasts
    assert len(still._samples) <= SPAN * RATE_HZ + 1
