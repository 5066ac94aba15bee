# SPDX-License-Identifier: Apache-2.0
"""Annotated image of a tracker result, for setting up a rig."""

import math
from collections.abc import Sequence

import numpy as np

from worm_driver.tracking import vision
from worm_driver.tracking.camera_pose import CameraPose, print_corners
from worm_driver.tracking.tracker import TrackedPositions, Tracker
from worm_driver.tracking.vision import Detection, Image, Label

# Colours (blue, green, red) of markers: reference, module, not in the setup, rejected.
_REFERENCE, _MODULE, _UNKNOWN, _REJECTED = (
    (255, 190, 60),
    (80, 220, 80),
    (160, 160, 160),
    (60, 60, 255),
)
_AXIS = (60, 200, 255)  # colour of the modules' line and of the expected reference markers
_MARGIN = 0.1  # m; length by which the drawn line extends beyond the reference markers


def preview(
    tracker: Tracker, image: Image, detections: Sequence[Detection], sample: TrackedPositions
) -> Image:
    """Return an image with the detected markers, the modules' line and the result, shape (height, width, 3)."""
    labels = [_label(tracker, detection, sample) for detection in detections]
    if sample.pose is not None:
        labels += _line(tracker, sample.pose)
    return vision.draw(image, labels, summary(tracker, detections, sample))


def _label(tracker: Tracker, detection: Detection, sample: TrackedPositions) -> Label:
    setup, number = tracker.setup, detection.number
    for name, module, position in (
        ("rear", setup.rear, sample.rear),
        ("front", setup.front, sample.front),
    ):
        if number == module.number:
            known = math.isfinite(position)
            text = (
                f"{number} {name} {position * 1e3:.2f} mm"
                if known
                else f"{number} {name}: rejected"
            )
            return Label(detection.corners, text, _MODULE if known else _REJECTED)
    if number in setup.reference:
        return Label(detection.corners, f"{number} reference", _REFERENCE)
    return Label(detection.corners, f"{number} not in the setup", _UNKNOWN)


def _line(tracker: Tracker, pose: CameraPose) -> list[Label]:
    """Return outlines of the modules' line and of the expected positions of the reference markers."""
    setup = tracker.setup
    along = [place[0] for place in setup.reference.values()]
    x = np.linspace(min(along) - _MARGIN, max(along) + _MARGIN, 60)
    points = np.column_stack([x, np.full_like(x, setup.line.y), np.full_like(x, setup.line.z)])
    there = vision.project(tracker.camera, points, pose.rotation, pose.shift)
    labels = [Label(np.concatenate([there, there[::-1]]), "modules' line, +x this way >", _AXIS)]
    for place in setup.reference.values():
        corners = print_corners(place, setup.marker_size, pose.facing)
        pixels = vision.project(tracker.camera, corners, pose.rotation, pose.shift)
        labels.append(Label(pixels, "", _AXIS))
    return labels


def summary(
    tracker: Tracker, detections: Sequence[Detection], sample: TrackedPositions
) -> list[str]:
    """Return a summary of the detections and of the measured positions, line by line."""
    missing = set(tracker.setup.reference) - {detection.number for detection in detections}
    lines = [f"{len(detections)} markers found"]
    if missing:
        lines.append(f"reference markers not found: {', '.join(map(str, sorted(missing)))}")
    if sample.pose is not None:
        x, y, z = sample.pose.position
        lines.append(
            f"reference markers fit within {sample.pose.error:.2f} px ({sample.pose.error_m * 1e3:.2f} mm); "
            f"camera at x {x:.3f}, y {y:.3f}, z {z:.3f} m"
        )
    if math.isfinite(sample.length):
        lines.append(
            f"x1 {sample.rear * 1e3:.2f} mm, x2 {sample.front * 1e3:.2f} mm, L {sample.length * 1e3:.2f} mm"
        )
    if sample.reason:
        lines.append(sample.reason)
    return lines
