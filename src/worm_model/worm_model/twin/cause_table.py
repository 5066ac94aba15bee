# SPDX-License-Identifier: Apache-2.0
"""Table of the causes that the twin can report.

The signatures, the candidate causes, the messages, the constants of TwinEvent.msg, the table in docs/twin.md and the
benchmark are made from these rows. To add a lasting cause, add a row to `LASTING`.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass


@dataclass(frozen=True)
class EventCode:
    """Code of TwinEvent.

    Attributes:
        code: value of `TwinEvent.code`.
        phrase: noun phrase that names the cause in a list of possible causes.
        meaning: description in TwinEvent.msg and docs/twin.md.
        evidence: instruments that show the cause.
    """

    code: str
    phrase: str
    meaning: str
    evidence: str


MISSED = EventCode(
    "missed_groove",
    "a missed groove",
    "a fin missed its last groove of a cycle; which fin is unknown",
    "tracker; power",
)
MISSED_REAR = EventCode(
    "missed_groove_rear",
    "a groove missed by the rear fin",
    "the rear fin missed its last groove of the cycle",
    "tracker; power",
)
MISSED_FRONT = EventCode(
    "missed_groove_front",
    "a groove missed by the front fin",
    "the front fin missed its last groove. The event names the next cycle, because only then x1 falls behind",
    "tracker; power",
)
GAINED = EventCode(
    "gained_groove", "a gained groove", "a fin gained one groove too many", "tracker; power"
)
ROBOT_MOVED = EventCode(
    "robot_moved",
    "a robot that was moved",
    "the position jumps by whole grooves, and no fin explains this",
    "tracker",
)
CAMERA_MOVED = EventCode(
    "camera_moved",
    "a camera that was moved",
    "the position jumps, but not by whole grooves",
    "tracker",
)
CABLE_SLIP = EventCode(
    "cable_slip",
    "a cable that slips, is slack or stretched",
    "gain or offset between command and body has changed: the cable slips, is slack or stretched",
    "measured length; without it positions and power",
)
FRICTION_UP = EventCode(
    "friction_up",
    "more friction",
    "viscous friction has increased",
    "power, and positions within the cycle",
)
FRICTION_DOWN = EventCode(
    "friction_down",
    "less friction",
    "viscous friction has decreased",
    "power, and positions within the cycle",
)
LOAD_UP = EventCode(
    "load_up",
    "more load",
    "the load along the pipe has increased towards -x: tether, slope or flow",
    "positions within the cycle; power",
)
LOAD_DOWN = EventCode(
    "load_down",
    "less load",
    "the load along the pipe has decreased, or pulls towards +x: tether, slope or flow",
    "positions within the cycle; power",
)
POWER_SCALE = EventCode(
    "power_scale",
    "another gain of the power measurement",
    "the gain of the power measurement has changed: supply or shunt",
    "power",
)
POWER_OFFSET = EventCode(
    "power_offset",
    "another offset of the power measurement",
    "the offset of the power measurement has changed: sensor, or another consumer on the supply",
    "power",
)
INITIAL_LENGTH = EventCode(
    "initial_length",
    "another L0",
    "L0 was wrong since the beginning of the run; the twin uses the new value",
    "tracker, at least two cycles",
)
CLOCK_JUMP = EventCode(
    "clock_jump", "a clock that was set", "the clock jumped, or was set during a gait", "stamps"
)
GAP = EventCode(
    "gap", "a gap in the data", "a time without data about the robot has ended", "stamps"
)
NEAR_EDGE = EventCode(
    "near_edge",
    "an edge of the grooves per cycle",
    "for information: a healthy robot gains either of two numbers of grooves, so whole grooves are not judged",
    "gait and L0",
)
AMBIGUOUS = EventCode(
    "ambiguous",
    "several causes",
    "several causes remain possible; the message lists them",
    "all instruments",
)


# factors from relative or SI values to the units in messages
_UNITS = {"%": 100.0, "mm": 1e3, "N": 1.0, "W": 1.0}


class Effect(enum.Enum):
    """Kind of change that a lasting cause makes to the model."""

    RELATIVE = enum.auto()  # the parameter with the row's name changes by a share of its value
    ABSOLUTE = enum.auto()  # the parameter with the row's name changes by an amount in its SI unit
    BOTH_LOADS = enum.auto()  # the load changes by an amount in N, one half of it on each module
    LOOSE_CABLE = enum.auto()  # the cable is longer by an amount in m
    POWER_SCALE = enum.auto()  # the measured power changes by a share
    POWER_OFFSET = enum.auto()  # the measured power changes by an amount in W


@dataclass(frozen=True)
class Cause:
    """Lasting change of the robot or of an instrument.

    Attributes:
        name: name of the signature; for a change of a parameter, the parameter's key.
        effect: kind of change of the model.
        up: code of an increase.
        down: code of a decrease.
        size: usual size of the change, relative or in the SI unit.
        unit: unit in messages.
        description: description of the change, with ``{}`` for its size.
        hint: possible explanation; empty if the code is sufficient.
        trials: sizes that the benchmark simulates, relative or in the SI unit; each row is (small, middle, large).
        large: sizes, as multiples of ``size``, that have their own signatures, because the effect is not proportional
            to the size.
        alone: cause that power alone does not distinguish from this one.
    """

    name: str
    effect: Effect
    up: EventCode
    down: EventCode
    size: float
    unit: str
    description: str
    hint: str
    trials: tuple[tuple[float, float, float], ...]
    large: tuple[float, ...] = ()
    alone: str = ""

    @property
    def least(self) -> float:
        """Lowest possible change, as a multiple of ``size``: a relative change makes no parameter negative."""
        return -1.0 / self.size if self.effect is Effect.RELATIVE else -math.inf

    @property
    def scale(self) -> float:
        """Factor from relative or SI values to the unit in messages."""
        return _UNITS[self.unit]

    def code(self, size: float) -> EventCode:
        """Return the code of a change: an increase or, for a negative size, a decrease."""
        return self.down if size < 0.0 else self.up

    def describe(self, size: float, deviation: float) -> str:
        """Return the description of a change with ± 2 standard deviations.

        Both arguments are multiples of the attribute `size`.
        """
        unit = self.scale * self.size
        value = f"{unit * size:+.1f} ± {2.0 * unit * deviation:.1f} {self.unit}"
        return self.description.format(value) + (f": {self.hint}" if self.hint else "")


#: lasting causes by name
LASTING = {
    row.name: row
    for row in (
        Cause(
            name="gain",
            effect=Effect.RELATIVE,
            up=CABLE_SLIP,
            down=CABLE_SLIP,
            size=0.05,
            unit="%",
            description="the gain from command to body length changed by {}",
            hint="a cable that slips, is slack or stretched",
            trials=((-0.01, -0.03, -0.06),),
        ),
        Cause(
            name="viscous_friction",
            effect=Effect.RELATIVE,
            up=FRICTION_UP,
            down=FRICTION_DOWN,
            size=0.5,
            unit="%",
            description="friction changed by {}",
            hint="",
            trials=((0.5, 1.0, 2.0), (-0.3, -0.6, -0.8)),
        ),
        Cause(
            name="rear_load",
            effect=Effect.ABSOLUTE,
            up=LOAD_UP,
            down=LOAD_DOWN,
            size=2.0,
            unit="N",
            description="the load on the rear module changed by {}",
            hint="tether",
            alone="a slipped cable",
            trials=((1.0, 3.0, 6.0), (-1.0, -2.0, -4.0)),
            large=(-2.5, -2.0, -1.0, 1.0, 2.0, 3.0),
        ),
        Cause(
            name="both_loads",
            effect=Effect.BOTH_LOADS,
            up=LOAD_UP,
            down=LOAD_DOWN,
            size=2.0,
            unit="N",
            description="the load on both modules together changed by {}",
            hint="slope of the pipe, or flow",
            alone="a slipped cable",
            trials=((1.0, 3.0, 6.0), (-1.0, -2.0, -4.0)),
            large=(-2.5, -2.0, -1.0, 1.0, 2.0, 3.0),
        ),
        Cause(
            name="slip",
            effect=Effect.LOOSE_CABLE,
            up=CABLE_SLIP,
            down=CABLE_SLIP,
            size=0.005,
            unit="mm",
            description="the body is longer under the same command by {}",
            hint="a cable that slips, is slack or stretched",
            trials=((0.001, 0.003, 0.006),),
        ),
        Cause(
            name="scale",
            effect=Effect.POWER_SCALE,
            up=POWER_SCALE,
            down=POWER_SCALE,
            size=0.1,
            unit="%",
            description="the gain of the power measurement changed by {}",
            hint="supply or shunt",
            trials=((0.04, 0.10, 0.20),),
        ),
        Cause(
            name="offset",
            effect=Effect.POWER_OFFSET,
            up=POWER_OFFSET,
            down=POWER_OFFSET,
            size=0.6,
            unit="W",
            description="the offset of the power measurement changed by {}",
            hint="power sensor, or another consumer on the supply",
            trials=((0.1, 0.3, 0.6),),
        ),
    )
}
#: codes of missed grooves by fin
MISSED_BY_FIN = {"rear": MISSED_REAR, "front": MISSED_FRONT}

_OTHERS = (MISSED, MISSED_REAR, MISSED_FRONT, GAINED, ROBOT_MOVED, CAMERA_MOVED)
_LAST = (INITIAL_LENGTH, CLOCK_JUMP, GAP, NEAR_EDGE, AMBIGUOUS)
#: all codes of TwinEvent
EVENT_CODES = tuple(
    dict.fromkeys(
        [*_OTHERS, *(code for row in LASTING.values() for code in (row.up, row.down)), *_LAST]
    )
)
