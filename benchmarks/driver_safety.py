# SPDX-License-Identifier: Apache-2.0
"""From a fault to a cable that stands still, on the virtual clock: the same figures on every machine."""

from __future__ import annotations

import random
import statistics
from collections.abc import Callable, Mapping

from benchmarks.report import Row
from tests.driver_rig import Rig
from worm_driver.gait.gait_player import Phase

TITLE = "from a fault to a cable that stands still"

#: s after the onset of a gait of 70 mm at 0.4 Hz at which the fault strikes: the cable runs in, out, fast and slowly
MOMENTS = (0.30, 0.62, 0.90, 1.60, 2.10)
#: m/s, below which the cable stands
STILL = 0.002
#: s, for which is looked
LOOKED = 1.0

#: a loop beside other work: share of the cycles that begin late, and s by which they do at most
LATE_SHARE, LATEST = 0.3, 0.030

Deed = Callable[[Rig], None]


def _injected(name: str, **arguments: object) -> Deed:
    return lambda rig: rig.inject(name, **arguments)


def _unplug(rig: Rig) -> None:
    rig.wire.unplugged = True


FAULTS: Mapping[str, Deed | None] = {
    "stop is called": lambda rig: rig.robot.stop(rig.clock.now, "stop"),
    "the cable servo is silent": _injected("no_answer", target=1, duration=5.0),
    "a fin servo is silent": _injected("no_answer", target=11, duration=5.0),
    "nothing answers": _injected("no_answer", duration=5.0),
    "all answers are garbled": _injected("corrupted_crc", duration=5.0),
    "answers are 12 ms late": _injected("late", duration=5.0, value=0.012),
    "answers are 45 ms late": _injected("late", duration=5.0, value=0.045),
    "a fin servo reports overload": _injected("overload", target=12),
    "the supply of the cable servo sags": _injected(
        "input_voltage", target=1, duration=5.0, value=4.0
    ),
    "the cable is blocked": _injected("stalled", target=1, duration=5.0),
    "the serial port is unplugged": _unplug,
    "the driver is killed": None,
}


def _cycle(rig: Rig, dice: random.Random | None) -> None:
    """One cycle of the driver, late now and then where the computer has other work."""
    period = rig.settings.period
    rig.clock.now = (int(rig.clock.now / period + 1e-6) + 1) * period
    if dice is not None and dice.random() < LATE_SHARE:
        rig.clock.now += dice.uniform(0.0, LATEST)
    rig.advance(rig.clock.now)
    rig.snapshots.append(rig.robot.cycle(rig.clock.now))


def _stopping_time(deed: Deed | None, moment: float, dice: random.Random | None) -> float:
    """S from the fault to the last moment at which the cable moved."""
    rig = Rig()
    rig.activate()
    rig.start()
    rig.run(5.0, until=lambda snapshot: snapshot.player.phase is Phase.RUNNING)
    onset = rig.clock.now
    while rig.clock.now < onset + moment:
        _cycle(rig, dice)
    begin = rig.clock.now
    rig.speeds.clear()
    if deed is None:
        rig.advance(begin + LOOKED)
    else:
        deed(rig)
        while rig.clock.now < begin + LOOKED:
            _cycle(rig, dice)
    return max((time for time, speed in rig.speeds if speed > STILL), default=begin) - begin


def run() -> list[Row]:
    """Each fault at several moments of a gait, without and with a loop that is late."""
    rows = []
    for name, deed in FAULTS.items():
        for load in ("idle", "busy"):
            dice = random.Random(1) if load == "busy" else None
            times = [_stopping_time(deed, moment, dice) for moment in MOMENTS]
            rows.append(
                Row(
                    f"{name}, {load}",
                    f"{max(times) * 1e3:.0f} ms",
                    "",
                    f"worst of {len(times)} moments of a gait, median {statistics.median(times) * 1e3:.0f} ms",
                )
            )
    return rows
