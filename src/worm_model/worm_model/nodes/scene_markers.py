# SPDX-License-Identifier: Apache-2.0
"""Conversion of the scene to visualization markers."""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from worm_model.twin.scene import FRAME, Kind, Shape

_TYPES = {Kind.BOX: Marker.CUBE, Kind.BOXES: Marker.CUBE_LIST, Kind.CYLINDER: Marker.CYLINDER}
_UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
_ALONG_X = Quaternion(x=0.0, y=math.sqrt(0.5), z=0.0, w=math.sqrt(0.5))
_LIFETIME_S = 1  # so that a robot that the tracker has lost disappears


def marker_array(shapes: Sequence[Shape], stamp: Time) -> MarkerArray:
    """Return one marker per shape, each in its own namespace so that viewers can hide it."""
    return MarkerArray(markers=[_marker(shape, stamp) for shape in shapes])


def _marker(shape: Shape, stamp: Time) -> Marker:
    red, green, blue, opacity = shape.colour
    marker = Marker(
        header=Header(stamp=stamp, frame_id=FRAME),
        ns=shape.name,
        id=0,
        type=_TYPES[shape.kind],
        action=Marker.ADD,
        scale=Vector3(**dict(zip("xyz", shape.size, strict=True))),
        color=ColorRGBA(r=red, g=green, b=blue, a=opacity),
        points=[Point(x=x, y=y, z=z) for x, y, z in shape.points],
    )
    x, y, z = shape.position
    turn = _ALONG_X if shape.kind is Kind.CYLINDER else _UPRIGHT
    marker.pose = Pose(position=Point(x=x, y=y, z=z), orientation=turn)
    marker.lifetime.sec = _LIFETIME_S
    return marker
