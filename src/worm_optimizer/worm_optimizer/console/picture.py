# SPDX-License-Identifier: Apache-2.0
"""Side view of the robot in its pipe as SVG.

Lengths along the pipe are to scale. The model contains no heights, so the radii of pipe and robot are arbitrary. Fins
bend to the grooves in which the twin computes them.
"""

from __future__ import annotations

import math

from worm_model.parameters import Parameters
from worm_model.twin.data.records import StateRecord
from worm_model.twin.scene import HOLDING, YIELDING, PositionSample, engagement

# Radii and widths of the drawing, mm.
RIDGE_RADIUS, GROOVE_RADIUS, WALL_RADIUS = 38.0, 46.0, 51.0
MODULE_RADIUS, MODULE_WIDTH = 20.0, 30.0
BELLOWS_RADIUS, FOLD_DEPTH, FOLDS = 13.0, 4.0, 13
_BESIDE = 120.0  # length of the pipe that is shown behind and ahead of the robot, mm
_WALL = 600.0  # length of the drawn wall behind and ahead of the robot, mm: a wide page shows more than the view box
_VIEW_STEP = 50.0  # mm; the view follows the robot in steps, so that the drawn pipe does not move all the time
_MM = 1e3


def picture(
    twin: StateRecord | None, robot: PositionSample, parameters: Parameters, direction: int
) -> str:
    """Return an SVG element with user units of 1 mm. Without a state of the twin, it shows an empty pipe and a note.

    Args:
        twin: state of the twin, None if unavailable.
        robot: position of the robot according to the tracker.
        parameters: parameters of the robot.
        direction: direction of the gait, which determines what the fins do.
    """
    pitch = _MM * parameters.pitch
    if twin is None:
        note = '<text x="0" y="4" text-anchor="middle">no data of the twin</text>'
        return _svg(-250.0, 500.0, _pipe(0.0, 0.0, pitch) + note, "Empty pipe: no data of the twin")
    rear, front = _MM * twin.rear_position, _MM * twin.front_position
    middle = round(0.5 * (rear + front) / _VIEW_STEP) * _VIEW_STEP
    width = _MM * parameters.initial_length + 2.0 * _BESIDE
    content = _pipe(_MM * twin.rear_anchor, middle, pitch)
    seen = robot.seen_at(twin.stamp_ns)
    if seen:
        content += _body("robot", _MM * robot.rear_position, _MM * robot.front_position)
    content += _body("twin", rear, front)
    doings = []
    for name, position, anchor in (
        ("rear", twin.rear_position, twin.rear_anchor),
        ("front", twin.front_position, twin.front_anchor),
    ):
        doing = _doing(position - anchor, parameters, direction)
        doings.append(f"{name} fins {doing}")
        content += _fins(doing.split()[0], _MM * position, _MM * anchor)
    words = (
        f"Twin from {rear:.0f} to {front:.0f} mm, {', '.join(doings)}; "
        f"robot {'seen' if seen else 'not seen by the tracker'}"
    )
    return _svg(middle - 0.5 * width, width, content, words)


def _doing(deflection: float, parameters: Parameters, direction: int) -> str:
    """Return what a fin with a deflection (m) does; the first word is also the CSS class of its drawing."""
    colour = engagement(deflection, parameters, direction)
    return {HOLDING: "hold", YIELDING: "yield"}.get(colour, "touch nothing")


def _svg(left: float, width: float, content: str, words: str) -> str:
    top, bottom = -WALL_RADIUS - 2.0, WALL_RADIUS + 16.0
    bar = f'<path class="scale" d="M{left + 8.0:.1f} {bottom - 7.0:.1f}h100"/>'
    bar += f'<text x="{left + 114.0:.1f}" y="{bottom - 3.0:.1f}">100 mm</text>'
    return (
        f'<svg class="worm" role="img" aria-label="{words}" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="{left:.1f} {top:.1f} {width:.1f} {bottom - top:.1f}">{content}{bar}</svg>'
    )


def _wave(step: float, height: float, count: int) -> str:
    """Return ``count`` half waves from the present point on; the first one reaches ``height`` (negative: up)."""
    return f"q{0.5 * step:.2f} {2.0 * height:.2f} {step:.2f} 0" + f"t{step:.2f} 0" * (count - 1)


def _pipe(groove: float, middle: float, pitch: float) -> str:
    """Return both walls around ``middle``, with one of their grooves at ``groove``; all in mm."""
    first = groove + (math.floor((middle - _WALL - groove) / pitch) - 0.25) * pitch
    count = 2 * math.ceil(2.0 * _WALL / pitch)
    inner = 0.5 * (GROOVE_RADIUS + RIDGE_RADIUS)
    depth = 0.5 * (GROOVE_RADIUS - RIDGE_RADIUS)
    return "".join(
        f'<path class="pipe" d="M{first:.2f} {side * inner:.1f}{_wave(0.5 * pitch, side * depth, count)}'
        f'V{side * WALL_RADIUS:.1f}H{first:.2f}z"/>'
        for side in (-1.0, 1.0)
    )


def _body(kind: str, rear: float, front: float) -> str:
    """Return modules, bellows and cable between positions in mm."""
    half, radius, depth = 0.5 * MODULE_WIDTH, BELLOWS_RADIUS, FOLD_DEPTH
    left, right = rear + half, max(front - half, rear + half + 1.0)
    count = 2 * FOLDS
    fold = (right - left) / count
    outline = (
        f"M{left:.2f} {-radius:.1f}{_wave(fold, -depth, count)}"
        f"V{radius:.1f}{_wave(-fold, -depth, count)}z"
    )
    modules = "".join(
        f'<rect class="{kind} module" x="{place - half:.2f}" y="{-MODULE_RADIUS:.1f}" rx="5" '
        f'width="{MODULE_WIDTH:.1f}" height="{2.0 * MODULE_RADIUS:.1f}"/>'
        for place in (rear, front)
    )
    cable = f'<path class="{kind} cable" d="M{left:.2f} 0H{right:.2f}"/>'
    return f'<path class="{kind} bellows" d="{outline}"/>{cable}{modules}'


def _fins(kind: str, root: float, groove: float) -> str:
    """Return both fins of a module, which bend from ``root`` to ``groove`` (mm), and the marks of their anchor.

    A fin leaves its module straight and bends to its groove.
    """
    low, high = MODULE_RADIUS, GROOVE_RADIUS - 2.0
    parts = []
    for side in (-1.0, 1.0):
        middle = side * 0.5 * (low + high)
        parts.append(
            f'<path class="fin {kind}" d="M{root:.2f} {side * low:.1f}'
            f'Q{root:.2f} {middle:.1f} {groove:.2f} {side * high:.1f}"/>'
            f'<path class="anchor" d="M{groove:.2f} {side * WALL_RADIUS - 2.5:.1f}l2 2.5-2 2.5-2-2.5z"/>'
        )
    return "".join(parts)
