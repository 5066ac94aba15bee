# SPDX-License-Identifier: Apache-2.0
"""Side view of the robot in its pipe, drawn from a pose of the model.

Lengths along the pipe are to scale, in mm. The model contains no heights, so the radii of pipe and robot are
arbitrary. The fins have the colours of the twin's scene: green if a fin holds, amber if it yields, grey if it touches
nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import FancyBboxPatch

from worm_model.analysis.plot_style import BLACK, BLUE, MM
from worm_model.arrays import Array
from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import Motions
from worm_model.twin.scene import FREE, HOLDING, YIELDING, engagement

# Radii and widths of the drawing, mm.
RIDGE_RADIUS, GROOVE_RADIUS, WALL_RADIUS = 38.0, 46.0, 51.0
MODULE_RADIUS, MODULE_WIDTH = 20.0, 30.0
BELLOWS_RADIUS, FOLD_DEPTH, FOLDS = 13.0, 4.0, 13
_SAG = 1.2  # mm by which the drawn cable hangs down for each mm of slack
_POINTS_PER_PITCH = 24
_PIPE_COLOUR, _MODULE_COLOUR, _BELLOWS_COLOUR = "#D9DBE0", "#BFD7EA", "#E8F0F7"


@dataclass(frozen=True)
class Pose:
    """Positions x1, x2 and anchors A1, A2 in m, and the slack of the cable in m."""

    x1: float
    x2: float
    rear_anchor: float
    front_anchor: float
    slack: float = 0.0


def pose_at(motions: Motions, command: Array, parameters: Parameters, index: int) -> Pose:
    """Return the pose at the time with the given index; ``command`` (n,) is u_cmd in m at the times of ``motions``."""
    return Pose(
        x1=float(motions.x1[index]),
        x2=float(motions.x2[index]),
        rear_anchor=float(motions.rear_anchor[index]),
        front_anchor=float(motions.front_anchor[index]),
        slack=max(float(command[index]) + parameters.slack, 0.0),
    )


def prepare_axes(
    axes: Axes, low: float, high: float, above: float = 4.0, below: float = 4.0
) -> None:
    """Set axes to show the pipe from ``low`` to ``high`` (m) to scale, without a frame.

    ``above`` and ``below`` are the room outside of the pipe's wall, mm.
    """
    axes.set(
        xlim=(MM * low, MM * high), ylim=(-WALL_RADIUS - below, WALL_RADIUS + above), aspect="equal"
    )
    axes.axis("off")


def draw_pipe(axes: Axes, pitch: float, low: float, high: float) -> None:
    """Draw both walls from ``low`` to ``high`` (m); grooves lie at the multiples of the pitch (m)."""
    x = np.linspace(low, high, math.ceil((high - low) / pitch * _POINTS_PER_PITCH))
    middle, depth = 0.5 * (GROOVE_RADIUS + RIDGE_RADIUS), 0.5 * (GROOVE_RADIUS - RIDGE_RADIUS)
    inner = middle + depth * np.cos(2.0 * np.pi * x / pitch)
    for side in (-1.0, 1.0):
        axes.fill_between(
            MM * x, side * inner, side * WALL_RADIUS, color=_PIPE_COLOUR, linewidth=0.0, zorder=1
        )
        axes.plot(MM * x, side * inner, color="0.55", linewidth=0.8, zorder=1)


class RobotDrawing:
    """Robot on prepared axes; `show` moves it to another pose."""

    def __init__(self, axes: Axes, parameters: Parameters, direction: int = FORWARD) -> None:
        self._parameters = parameters
        self._direction = direction
        (self._bellows,) = axes.fill([], [], color=_BELLOWS_COLOUR, ec=BLUE, lw=0.8, zorder=2)
        (self._cable,) = axes.plot([], [], color=BLACK, linewidth=1.2, zorder=3)
        self._modules = [_module(axes) for _ in range(2)]
        self._fins = [_fin(axes) for _ in range(2)]
        self._anchors = [_anchor_marks(axes) for _ in range(2)]

    def show(self, pose: Pose) -> None:
        """Move the drawing to a pose."""
        rear, front = MM * pose.x1, MM * pose.x2
        self._bellows.set_xy(_bellows(rear + 0.5 * MODULE_WIDTH, front - 0.5 * MODULE_WIDTH))
        u = np.linspace(0.0, 1.0, 41)
        sag = _SAG * MM * pose.slack * np.sin(np.pi * u)
        self._cable.set_data(rear + (front - rear) * u, -sag)
        anchors = pose.rear_anchor, pose.front_anchor
        parts = zip((pose.x1, pose.x2), anchors, self._modules, self._fins, strict=True)
        for position, anchor, module, fins in parts:
            module.set_x(MM * position - 0.5 * MODULE_WIDTH)
            colour = engagement(position - anchor, self._parameters, self._direction)
            for side, fin in zip((-1.0, 1.0), fins, strict=True):
                fin.set_data(*_bent_fin(MM * position, MM * anchor, side))
                fin.set_color(colour)
        for anchor, marks in zip(anchors, self._anchors, strict=True):
            marks.set_data([MM * anchor] * 2, [-WALL_RADIUS, WALL_RADIUS])


def _module(axes: Axes) -> FancyBboxPatch:
    module = FancyBboxPatch(
        (0.0, -MODULE_RADIUS),
        MODULE_WIDTH,
        2.0 * MODULE_RADIUS,
        boxstyle="round,pad=0,rounding_size=5",
        facecolor=_MODULE_COLOUR,
        edgecolor=BLUE,
        linewidth=1.2,
        zorder=4,
    )
    axes.add_patch(module)
    return module


def _fin(axes: Axes) -> list[Line2D]:
    """Return the two lines of a fin pair, one to each wall."""
    return [axes.plot([], [], lw=4.0, solid_capstyle="round", zorder=5)[0] for _ in range(2)]


def _anchor_marks(axes: Axes) -> Line2D:
    """Return the marks on the wall at the groove in which a fin pair sits."""
    (marks,) = axes.plot([], [], "d", color=BLACK, markersize=5, zorder=5)
    return marks


def _bellows(left: float, right: float) -> Array:
    """Return the outline (n, 2) of the folded body between two modules, mm."""
    u = np.linspace(0.0, 1.0, 12 * FOLDS + 1)
    radius = BELLOWS_RADIUS + FOLD_DEPTH * np.cos(2.0 * np.pi * FOLDS * u)
    x = left + (right - left) * u
    return np.column_stack([np.concatenate([x, x[::-1]]), np.concatenate([radius, -radius[::-1]])])


def _bent_fin(root: float, groove: float, side: float) -> tuple[Array, Array]:
    """Return the line of a fin that leaves its module straight and bends to its groove, mm."""
    t = np.linspace(0.0, 1.0, 21)
    low, high = MODULE_RADIUS, GROOVE_RADIUS - 2.0
    return root + (groove - root) * t * t, side * (low + (high - low) * t)


def explain_colours(figure: Figure | SubFigure, **place: Any) -> None:
    """Add a legend of the fins' colours and of the anchors; ``place`` is passed to `Figure.legend`."""
    meanings = (("holds", HOLDING), ("yields", YIELDING), ("touches nothing", FREE))
    handles = [Line2D([], [], color=c, linewidth=4.0, label=f"fin {name}") for name, c in meanings]
    handles.append(Line2D([], [], color=BLACK, marker="d", linestyle="none", label="anchor"))
    figure.legend(
        handles=handles, ncols=4, fontsize="small", frameon=False, columnspacing=1.2, **place
    )
