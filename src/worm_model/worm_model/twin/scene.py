# SPDX-License-Identifier: Apache-2.0
"""Simple shapes for the pipe, the tracked robot and the twin.

The pipe lies along x in the frame ``FRAME``. Lengths are in m, colours are (red, green, blue, opacity) from 0 to 1.
Fins are green where they hold, amber where they yield, and grey where they touch nothing.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.twin.data.records import NANOSECONDS, StateRecord

FRAME = "pipe"
PIPE_RADIUS = 0.06
MODULE = (0.04, 0.07, 0.07)  # size of a module along x, y and z
BELLOWS_DIAMETER = 0.05
LOST_S = 1.0  # largest age of the latest tracker sample with which the robot is drawn
VIEW = 0.6  # length of pipe shown ahead of the robot and behind it

Colour = tuple[float, float, float, float]
Vector = tuple[float, float, float]

RIDGE_COLOUR: Colour = (0.55, 0.55, 0.6, 0.5)
ROBOT_COLOUR: Colour = (0.15, 0.35, 0.75, 1.0)
GHOST_COLOUR: Colour = (0.95, 0.75, 0.2, 0.35)
HOLDING: Colour = (0.1, 0.7, 0.2, 1.0)
YIELDING: Colour = (0.95, 0.6, 0.1, 1.0)
FREE: Colour = (0.6, 0.6, 0.6, 1.0)


class ShapeKind(enum.Enum):
    """Kind of a shape."""

    BOX = "box"
    BOXES = "boxes"
    CYLINDER = "cylinder along x"


@dataclass(frozen=True)
class Shape:
    """Shape with a unique ``name``.

    ``size`` is the extent of a box along x, y and z, or two diameters and the length of a cylinder. ``points`` are the
    centres of BOXES relative to ``position``.
    """

    name: str
    kind: ShapeKind
    position: Vector
    size: Vector
    colour: Colour
    points: tuple[Vector, ...] = ()


@dataclass(frozen=True)
class PositionSample:
    """Latest sample of the tracker: x1 and x2 in m, NaN if not visible, and its stamp in ns."""

    rear_position: float = math.nan
    front_position: float = math.nan
    stamp_ns: int = 0

    def seen_at(self, stamp_ns: int) -> bool:
        """Return True if both positions are known and at most `LOST_S` away from a stamp (ns)."""
        both = math.isfinite(self.rear_position) and math.isfinite(self.front_position)
        return both and abs(stamp_ns - self.stamp_ns) <= LOST_S * NANOSECONDS


def scene(
    twin: StateRecord, robot: PositionSample, parameters: Parameters, direction: int = FORWARD
) -> list[Shape]:
    """Return the shapes of pipe and twin, and of the robot if the tracker sees both modules at the twin's stamp."""
    shapes = [ridges(twin, parameters)]
    shapes += body("twin", twin.rear_position, twin.front_position, GHOST_COLOUR)
    shapes += [
        fin("rear", twin.rear_position, twin.rear_anchor, parameters, direction),
        fin("front", twin.front_position, twin.front_anchor, parameters, direction),
    ]
    if robot.seen_at(twin.stamp_ns):
        shapes += body("robot", robot.rear_position, robot.front_position, ROBOT_COLOUR)
    return shapes


def ridges(twin: StateRecord, parameters: Parameters) -> Shape:
    """Return the ridges of the pipe around the twin, midway between grooves."""
    pitch, zero = parameters.pitch, twin.rear_anchor
    first = math.floor((twin.rear_position - VIEW - zero) / pitch)
    last = math.ceil((twin.front_position + VIEW - zero) / pitch)
    points = tuple(
        (zero + (k + 0.5) * pitch, 0.0, side * PIPE_RADIUS)
        for k in range(first, last)
        for side in (-1.0, 1.0)
    )
    size = (0.2 * pitch, 2.0 * PIPE_RADIUS, 0.006)
    return Shape("pipe ridges", ShapeKind.BOXES, (0.0, 0.0, 0.0), size, RIDGE_COLOUR, points)


def body(name: str, rear: float, front: float, colour: Colour) -> list[Shape]:
    """Return both modules, at their positions (m), and the bellows between them."""
    gap = max(front - rear - MODULE[0], 1e-3)
    middle = 0.5 * (rear + front)
    return [
        Shape(f"{name} rear module", ShapeKind.BOX, (rear, 0.0, 0.0), MODULE, colour),
        Shape(f"{name} front module", ShapeKind.BOX, (front, 0.0, 0.0), MODULE, colour),
        Shape(
            f"{name} bellows",
            ShapeKind.CYLINDER,
            (middle, 0.0, 0.0),
            (BELLOWS_DIAMETER, BELLOWS_DIAMETER, gap),
            (*colour[:3], 0.5 * colour[3]),
        ),
    ]


def fin(name: str, position: float, anchor: float, parameters: Parameters, direction: int) -> Shape:
    """Return the fins of a module, from root to groove, coloured by their engagement (eq:fin_force_piecewise)."""
    reach = anchor - position
    size = (max(abs(reach), 0.004), 0.02, 2.0 * PIPE_RADIUS)
    colour = engagement(position - anchor, parameters, direction)
    return Shape(f"{name} fins", ShapeKind.BOX, (position + 0.5 * reach, 0.0, 0.0), size, colour)


def engagement(displacement: float, parameters: Parameters, direction: int) -> Colour:
    """Return the colour of a fin with a deflection (m). A fin holds if it is deflected against ``direction``."""
    if abs(displacement) <= 0.5 * parameters.clearance:
        return FREE
    return HOLDING if displacement * direction < 0.0 else YIELDING
