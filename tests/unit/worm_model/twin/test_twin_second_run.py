# SPDX-License-Identifier: Apache-2.0
"""A second run in one session of a virtual robot in even grooves, whose plant is independent of the twin."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from virtual_session import Session, live_twin, virtual_settings

from worm_model.gait import REVERSE, Gait
from worm_model.parameters import PAPER
from worm_model.twin.data.samples import SampleKind

CYCLES, SECOND = 3, 10**9
GAIT, LONG, BACKWARD = Gait(0.07, 0.4), Gait(0.08, 0.4), Gait(0.07, 0.4, REVERSE)


@lru_cache
def session(second: Gait, release_s: float = 0.5) -> tuple[np.ndarray, int]:
    """Return the samples, and the onset of the second run (ns).

    The transmission returns its slack when the cable has rested for ``release_s``.
    """
    usual = virtual_settings()
    effects = replace(
        usual.effects, threshold_scatter=0.0, stiffness_scatter=0.0, slack_release=release_s
    )
    camera = replace(usual.tracker, noise=0.0, occlusion_rate=0.0)
    played = Session(replace(usual, effects=effects, tracker=camera))
    played.run(GAIT, CYCLES)
    again = played.run(second, CYCLES, after=0.0).onset_ns
    return played.rows, again


@pytest.mark.parametrize("second", [GAIT, LONG, BACKWARD])
def test_the_command_alone_predicts_where_a_second_run_ends(second):
    rows, again = session(second)
    seen = rows["a"][rows["kind"] == SampleKind.POSITION]
    driver = np.isin(rows["kind"], [SampleKind.COMMAND, SampleKind.GAIT])
    states = live_twin(rows[driver]).states
    moved = states["rear_position"][-1] - states["rear_position"][0]
    assert moved == pytest.approx(seen[-1] - seen[0], abs=1.5e-3)
    start = states[states["energy"] == 0.0][-1]
    assert start["stamp_ns"] == again
    assert (start["rear_groove"], start["front_groove"]) == (0, 0)


@pytest.mark.parametrize("second", [GAIT, BACKWARD])
@pytest.mark.parametrize("carried_mm", [0.0, 1000.0 * PAPER.pitch])
def test_a_camera_confirms_the_twin_through_a_second_run(second, carried_mm):
    rows, again = session(second)
    rows = rows.copy()
    carried = (rows["kind"] == SampleKind.POSITION) & (rows["stamp"] > again - 2 * SECOND)
    for marker in ("a", "b"):
        rows[marker][carried] += 1e-3 * carried_mm
    found = live_twin(rows)
    residuals = found.residuals["rear_position"][found.residuals["stamp_ns"] > again]
    assert np.isfinite(residuals).sum() > 100
    assert np.nanmax(np.abs(residuals)) < 2e-3
    assert not any("the robot was moved" in event.text for event in found.events)


@pytest.mark.parametrize("second", [GAIT, LONG])
def test_slack_that_is_still_being_taken_up_is_not_another_l0(second):
    samples, again = session(second, release_s=100.0)
    found = live_twin(samples)
    assert any("the slack is still taken up" in event.text for event in found.events)
    later = found.states[found.states["stamp_ns"] > again]
    assert np.abs(later["initial_length"] - PAPER.initial_length).max() < 1e-4
    rows = found.residuals[found.residuals["stamp_ns"] > again + SECOND]
    assert np.nanmax(np.abs(rows["length"])) < 1.5e-3
    assert np.nanmax(np.abs(rows["rear_position"])) < 1.5e-3
