# SPDX-License-Identifier: Apache-2.0
"""Positions from markers; implausible ones are NaN with a reason."""

import math
from dataclasses import replace

import numpy as np
import pytest
from camera_rig import LENGTH, SETTINGS, PaperCamera, setup_of, turned
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.driver_errors import SetupError
from worm_driver.tracking.tracker import Tracker
from worm_driver.tracking.tracker_setup import ModuleMarker

CAMERA = PaperCamera()
Y, Z = SETTINGS.module_line


def see(*modules, tracker: Tracker | None = None, time: float = 0.0):
    return (tracker or Tracker(setup_of(SETTINGS))).see([*CAMERA.references(), *modules], time)


@given(st.floats(-0.1, 0.3), st.floats(0.1, 0.4), st.floats(-0.05, 0.05), st.floats(-0.03, 0.03))
def test_positions_are_exact_at_any_depth_of_the_line(rear, length, y, z):
    """Parallax: a marker that is nearer to the camera than the references appears elsewhere."""
    rig = replace(SETTINGS, module_line=(y, z))
    camera = PaperCamera(rig)
    tracker = Tracker(setup_of(rig))
    seen = tracker.see([*camera.references(), *camera.modules(rear, rear + length)], 0.0)
    assert (seen.rear, seen.front) == pytest.approx((rear, rear + length), abs=1e-5)
    assert seen.length == pytest.approx(length, abs=1e-5)
    assert seen.reason == ""


@given(st.sampled_from([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]), st.floats(-0.17, 0.17))
def test_a_tilt_of_the_print_moves_nothing(axis, angle):
    seen = see(CAMERA.marker(0, (0.1, Y, Z), tilt=turned(axis, angle)))
    assert seen.rear == pytest.approx(0.1, abs=2e-5)


def test_offsets_lead_to_the_fins_and_positions_count_from_the_first_reference():
    reference = {11: SETTINGS.reference[11], 10: SETTINGS.reference[10]}
    setup = setup_of(
        SETTINGS, rear=ModuleMarker(0, -0.012), front=ModuleMarker(1, 0.03), reference=reference
    )
    seen = see(*CAMERA.modules(), tracker=Tracker(setup))
    assert seen.rear == pytest.approx(-0.012 - 0.4, abs=1e-5)
    assert seen.front == pytest.approx(LENGTH + 0.03 - 0.4, abs=1e-5)


@pytest.mark.parametrize(
    ("rear", "reason"),
    [
        ([], "rear marker 0 is not found"),
        ([CAMERA.marker(0, (0.0, Y, Z))] * 2, "rear marker 0 is visible 2 times"),
        ([CAMERA.marker(0, (0.0, Y, Z + 0.02))], "19.6 mm"),
        ([CAMERA.marker(0, (0.0, Y, Z), size=0.02)], "wrong size, 0.80 of marker_size_m"),
        ([CAMERA.marker(0, (0.0, Y, Z), tilt=turned((0, 1, 0), 0.5))], "29 degrees"),
        ([replace(CAMERA.marker(0, (0.0, Y, Z)), edge_width=1.2)], "blurred over 1.2 cells"),
        ([replace(CAMERA.marker(0, (0.0, Y, Z)), edge_width=math.inf)], "without clear edges"),
    ],
)
def test_what_cannot_be_is_hidden_with_a_reason(rear, reason):
    seen = see(*rear, CAMERA.modules()[1])
    assert math.isnan(seen.rear)
    assert math.isnan(seen.length)
    assert seen.front == pytest.approx(LENGTH, abs=1e-5)
    assert reason in seen.reason
    assert "front" not in seen.reason


def test_a_jump_is_rejected_until_the_module_can_have_moved_there():
    tracker = Tracker(setup_of(SETTINGS))
    see(*CAMERA.modules(), tracker=tracker, time=0.0)
    jump = see(*CAMERA.modules(rear=0.1), tracker=tracker, time=1 / 30)
    assert math.isnan(jump.rear)
    assert "is 100 mm from where it was 33 ms before" in jump.reason
    assert math.isfinite(jump.front)
    later = see(*CAMERA.modules(rear=0.1), tracker=tracker, time=0.25)
    assert later.rear == pytest.approx(0.1, abs=1e-5)
    set_back = see(*CAMERA.modules(rear=0.0), tracker=tracker, time=-5.0)  # the clock was set
    assert set_back.rear == pytest.approx(0.0, abs=1e-5)


def test_the_delay_is_subtracted_from_the_stamp():
    tracker = Tracker(setup_of(SETTINGS, delay=0.04))
    assert see(*CAMERA.modules(), tracker=tracker, time=2.0).time == pytest.approx(1.96)


BLURRED = [replace(detection, edge_width=2.0) for detection in CAMERA.references()]


@pytest.mark.parametrize("references", [[], BLURRED], ids=["none", "blurred"])
def test_without_a_clear_reference_marker_there_is_no_pose_and_no_position(references):
    seen = Tracker(setup_of(SETTINGS)).see([*references, *CAMERA.modules()], 0.0)
    assert np.isnan([seen.rear, seen.front]).all()
    assert "no reference marker in view" in seen.reason
    assert seen.pose is None


def test_a_calibration_is_required():
    with pytest.raises(SetupError, match=r"lost.yaml.*No such file.*calibrate_camera"):
        Tracker(setup_of(SETTINGS, camera_info="lost.yaml"))


def test_a_poorly_measured_reference_is_reported_once():
    x, y, z = SETTINGS.reference[11]
    places = {**SETTINGS.reference, 11: (x + 0.003, y, z)}
    tracker = Tracker(setup_of(SETTINGS, reference=places))
    first, second = (see(*CAMERA.modules(), tracker=tracker, time=t) for t in (0.0, 0.1))
    assert "0.27 mm" in first.event
    assert second.event == ""
    assert math.isfinite(first.rear)
