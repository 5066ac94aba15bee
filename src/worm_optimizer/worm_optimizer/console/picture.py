# SPDX-License-Identifier: Apache-2.0
"""Side view of the robot in its pipe as SVG, to scale, from the shapes of the twin's scene."""

from __future__ import annotations

from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.twin.data.records import StateRecord
from worm_model.twin.scene import PIPE_RADIUS, PositionSample, Shape, ShapeKind, scene

BEFORE, BEHIND = 0.12, 0.12  # length of the pipe that is shown ahead of and behind the robot, m
_WALL = 0.006  # thickness of the drawn wall, m
_VIEW_STEP = 0.05  # m; the view follows the robot in steps, so that the drawn pipe does not move all the time
_NAMES = {"twin": "ghost", "robot": "robot", "pipe": "pipe", "rear": "fins", "front": "fins"}


def picture(
    twin: StateRecord | None,
    robot: PositionSample,
    parameters: Parameters,
    direction: int = FORWARD,
) -> str:
    """Return an SVG element with user units of 1 mm. Without a state of the twin, it shows an empty pipe and a note.

    Args:
        twin: state of the twin, None if unavailable.
        robot: position of the robot according to the tracker.
        parameters: parameters of the robot.
        direction: direction of the gait, which determines the colours of the fins.
    """
    if twin is None:
        return _svg(0.0, 0.5, _note(0.25, "no data of the twin"), "The empty pipe")
    middle = 0.5 * (twin.rear_position + twin.front_position)
    left = round(middle / _VIEW_STEP) * _VIEW_STEP - 0.5 * parameters.initial_length - BEHIND
    width = parameters.initial_length + BEHIND + BEFORE
    shapes = scene(twin, robot, parameters, direction)
    shown = "".join(_drawn(shape) for shape in shapes)
    text = (
        f"Twin from {1e3 * twin.rear_position:.0f} to {1e3 * twin.front_position:.0f} mm, "
        f"robot {'seen' if robot.seen_at(twin.stamp_ns) else 'not seen by the tracker'}"
    )
    return _svg(left, width, shown, text)


def _svg(left: float, width: float, content: str, words: str) -> str:
    half = 1e3 * (PIPE_RADIUS + 2.0 * _WALL)
    # The walls are longer than the view box, because a wide page shows more than the view box.
    walls = "".join(
        _rect("pipe", left - width, side * (PIPE_RADIUS + 0.5 * _WALL), 3.0 * width, _WALL)
        for side in (-1.0, 1.0)
    )
    return (
        f'<svg class="worm" role="img" aria-label="{words}" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="{1e3 * left:.1f} {-half:.1f} {1e3 * width:.1f} {2.0 * half + 20.0:.1f}">'
        f"{content}{walls}{_scale_bar(left, half)}</svg>"
    )


def _drawn(shape: Shape) -> str:
    """Return a shape as rectangles. Their CSS classes come from `_NAMES`."""
    kind = _NAMES[shape.name.split()[0]]
    x, _, z = shape.position
    if shape.kind is ShapeKind.BOXES:
        size = (shape.size[0], 2.0 * _WALL)
        return "".join(_box(kind, x + dx, z + dz, size) for dx, _, dz in shape.points)
    if shape.kind is ShapeKind.CYLINDER:
        return _box(f"{kind} bellows", x, z, (shape.size[2], shape.size[0]))
    if kind == "fins":
        red, green, blue, _ = shape.colour
        colour = f"rgb({255 * red:.0f},{255 * green:.0f},{255 * blue:.0f})"
        return _box(kind, x, z, (max(shape.size[0], 0.006), shape.size[2]), colour)
    return _box(kind, x, z, (shape.size[0], shape.size[2]))


def _box(kind: str, x: float, z: float, size: tuple[float, float], colour: str = "") -> str:
    return _rect(kind, x - 0.5 * size[0], z, *size, colour)


def _rect(kind: str, left: float, z: float, width: float, height: float, colour: str = "") -> str:
    fill = f' style="fill:{colour}"' if colour else ""
    return (
        f'<rect class="{kind}" x="{1e3 * left:.1f}" y="{1e3 * (-z - 0.5 * height):.1f}" '
        f'width="{1e3 * width:.1f}" height="{1e3 * height:.1f}"{fill}/>'
    )


def _scale_bar(left: float, half: float) -> str:
    at, y = 1e3 * left + 8.0, half + 9.0
    return (
        f'<path class="scale" d="M{at:.1f} {y:.1f}h100"/>'
        f'<text class="scale" x="{at + 104:.1f}" y="{y + 3.0:.1f}">100 mm</text>'
    )


def _note(x: float, text: str) -> str:
    return f'<text class="none" x="{1e3 * x:.0f}" y="4" text-anchor="middle">{text}</text>'
