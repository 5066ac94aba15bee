# SPDX-License-Identifier: Apache-2.0
"""Markers of the pipe, the tracked robot and the twin, for RViz and Foxglove.

The pipe lies along x in the frame `FRAME`. Each marker has its own namespace, so that viewers can hide single ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from worm_model.nodes.twin_messages import time_message
from worm_model.parameters import Parameters
from worm_model.twin.data.records import StateRecord
from worm_model.twin.scene import FRAME, Colour, PositionSample, engagement

PIPE_RADIUS = 0.06
MODULE = (0.04, 0.07, 0.07)  # size of a module along x, y and z
BELLOWS_DIAMETER = 0.05
VIEW = 0.6  # length of pipe shown ahead of the robot and behind it
RIDGES: Colour = (0.55, 0.55, 0.6, 0.5)
ROBOT: Colour = (0.15, 0.35, 0.75, 1.0)
GHOST: Colour = (0.95, 0.75, 0.2, 0.35)

_UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
_ALONG_X = Quaternion(x=0.0, y=math.sqrt(0.5), z=0.0, w=math.sqrt(0.5))
_LIFETIME_S = 1  # time after which a marker disappears if it is not published again


def markers(
    twin: StateRecord, robot: PositionSample, parameters: Parameters, direction: int
) -> MarkerArray:
    """Return the markers of pipe and twin, and of the robot if the tracker sees both modules at the twin's stamp."""
    found = [_ridges(twin, parameters)]
    found += _body("twin", twin.rear_position, twin.front_position, GHOST)
    for name, position, anchor in (
        ("rear fins", twin.rear_position, twin.rear_anchor),
        ("front fins", twin.front_position, twin.front_anchor),
    ):
        # from the root to the groove
        size = (max(abs(anchor - position), 0.004), 0.02, 2.0 * PIPE_RADIUS)
        colour = engagement(position - anchor, parameters, direction)
        found.append(_marker(name, 0.5 * (position + anchor), size, colour))
    if robot.seen_at(twin.stamp_ns):
        found += _body("robot", robot.rear_position, robot.front_position, ROBOT)
    for marker in found:
        marker.header = Header(stamp=time_message(twin.stamp_ns), frame_id=FRAME)
    return MarkerArray(markers=found)


def _ridges(twin: StateRecord, parameters: Parameters) -> Marker:
    """Return the ridges of the pipe around the twin, midway between grooves."""
    pitch, zero = parameters.pitch, twin.rear_anchor
    first = math.floor((twin.rear_position - VIEW - zero) / pitch)
    last = math.ceil((twin.front_position + VIEW - zero) / pitch)
    points = (
        Point(x=zero + (k + 0.5) * pitch, y=0.0, z=side * PIPE_RADIUS)
        for k in range(first, last)
        for side in (-1.0, 1.0)
    )
    size = (0.2 * pitch, 2.0 * PIPE_RADIUS, 0.006)
    return _marker("pipe ridges", 0.0, size, RIDGES, Marker.CUBE_LIST, points)


def _body(name: str, rear: float, front: float, colour: Colour) -> list[Marker]:
    """Return both modules, at their positions (m), and the bellows between them."""
    bellows = (BELLOWS_DIAMETER, BELLOWS_DIAMETER, max(front - rear - MODULE[0], 1e-3))
    faint = (*colour[:3], 0.5 * colour[3])
    return [
        _marker(f"{name} rear module", rear, MODULE, colour),
        _marker(f"{name} front module", front, MODULE, colour),
        _marker(f"{name} bellows", 0.5 * (rear + front), bellows, faint, Marker.CYLINDER),
    ]


def _marker(
    name: str,
    x: float,
    size: tuple[float, float, float],
    colour: Colour,
    kind: int = Marker.CUBE,
    points: Iterable[Point] = (),
) -> Marker:
    """Return a marker with its centre on the axis, at ``x`` (m).

    ``size`` is the extent of a cube along x, y and z, or two diameters and the length of a cylinder along x. ``points``
    are the centres of the cubes of a list.
    """
    red, green, blue, opacity = colour
    marker = Marker(
        ns=name,
        type=kind,
        action=Marker.ADD,
        scale=Vector3(**dict(zip("xyz", size, strict=True))),
        color=ColorRGBA(r=red, g=green, b=blue, a=opacity),
        points=list(points),
    )
    turn = _ALONG_X if kind == Marker.CYLINDER else _UPRIGHT
    marker.pose = Pose(position=Point(x=x, y=0.0, z=0.0), orientation=turn)
    marker.lifetime.sec = _LIFETIME_S
    return marker
