# SPDX-License-Identifier: Apache-2.0
"""The camera's pose from reference markers, and the detection of a camera or a marker that moved."""

import re
from dataclasses import replace

import numpy as np
import pytest
from camera_rig import SETTINGS, PaperCamera, model_of, setup_of
from hypothesis import given
from hypothesis import strategies as st
from rendered_images import axes_of

from worm_driver.driver_errors import PoseError
from worm_driver.tracking.camera_pose import FixedCamera, find_pose

SETUP, CAMERA = setup_of(SETTINGS), model_of(SETTINGS)


def corners(camera: PaperCamera, *left_out: int) -> dict[int, np.ndarray]:
    return {d.number: d.corners for d in camera.references() if d.number not in left_out}


def fixed() -> FixedCamera:
    return FixedCamera(SETUP, CAMERA)


@given(st.floats(-0.35, 0.35), st.floats(-0.3, 0.3), st.floats(-0.2, 0.2), st.floats(0.4, 1.0))
def test_the_pose_is_that_of_the_camera(yaw, pitch, roll, distance):
    settings = replace(SETTINGS, yaw=yaw, pitch_angle=pitch, roll=roll)
    forward = axes_of(settings)[2]
    place = np.array([0.2, -0.03, 0.0]) - distance * forward
    settings = replace(settings, position=tuple(place))
    pose = find_pose(SETUP, CAMERA, corners(PaperCamera(settings)))
    assert pose.position == pytest.approx(place, abs=1e-5)
    assert pose.rotation[2] == pytest.approx(forward, abs=1e-5)
    assert pose.facing == -1
    assert pose.error < 1e-3


def test_a_camera_on_the_other_side_of_the_pipe():
    """Seen from +y, +x is to the left: the mirror image of a rig in x and y."""
    mirrored = {n: (-x, -y, z) for n, (x, y, z) in SETTINGS.reference.items()}
    pose = find_pose(
        setup_of(replace(SETTINGS, reference=mirrored)), CAMERA, corners(PaperCamera())
    )
    x, y, z = SETTINGS.position
    assert pose.facing == 1
    assert pose.position == pytest.approx([-x, -y, z], abs=1e-5)


MISPLACED = setup_of(replace(SETTINGS, reference={**SETTINGS.reference, 11: (0.41, -0.035, 0.075)}))
UPSIDE_DOWN = {n: np.roll(quad, 2, axis=0) for n, quad in corners(PaperCamera()).items()}


@pytest.mark.parametrize(
    ("setup", "seen", "reason"),
    [
        (SETUP, corners(PaperCamera(), 11, 12, 13), "10; at least 2"),
        (MISPLACED, corners(PaperCamera()), r"0\.9 mm.*reference"),
        (SETUP, UPSIDE_DOWN, "upright"),
    ],
    ids=["one marker", "wrong position in the setup", "prints on their heads"],
)
def test_markers_that_give_no_pose_are_reported(setup, seen, reason):
    with pytest.raises(PoseError, match=reason):
        find_pose(setup, CAMERA, seen)


def test_ambiguous_poses_are_rejected():
    """Small prints next to each other, far away: noise hides which side is nearer."""
    settings = replace(
        SETTINGS,
        reference={10: (0.0, 0.0, 0.0), 11: (0.03, 0.0, 0.0)},
        marker_size=0.02,
        position=(0.6, -3.0, 0.4),
        yaw=0.2,
        pitch_angle=-0.13,
    )
    setup = setup_of(settings)
    camera = PaperCamera(settings)
    noise = np.random.default_rng(3)
    seen = {
        n: camera.marker(n, place, 0.02).corners + noise.normal(0.0, 0.1, (4, 2))
        for n, place in settings.reference.items()
    }
    with pytest.raises(PoseError, match="two camera positions"):
        find_pose(setup, CAMERA, seen)


def test_noise_averages_out_for_a_fixed_camera():
    noise = np.random.default_rng(1)
    camera = fixed()
    exact = corners(PaperCamera())
    for _ in range(64):
        seen = {n: quad + noise.normal(0.0, 0.1, (4, 2)) for n, quad in exact.items()}
        pose = camera.update(seen).pose
    single = find_pose(SETUP, CAMERA, seen)
    true = np.array(SETTINGS.position)
    assert np.linalg.norm(pose.position - true) < 0.5 * np.linalg.norm(single.position - true)
    assert np.linalg.norm(pose.position - true) < 3e-4


def test_a_bumped_camera_is_noticed_and_moved_and_found_again():
    camera = fixed()
    before, after = PaperCamera(), PaperCamera(replace(SETTINGS, yaw=SETTINGS.yaw + 0.002))
    for _ in range(5):
        assert camera.update(corners(before)).problem == ""
    bumped = camera.update(corners(after))
    assert bumped.pose is None
    assert "camera" in bumped.problem
    assert "camera" in bumped.event
    assert "10 by 2." in bumped.event  # 2 mrad at 1010 pixels
    found = camera.update(corners(after))
    assert found.event == ""
    assert found.pose.position == pytest.approx(SETTINGS.position, abs=1e-5)


def test_a_marker_that_moved_is_ignored():
    camera = fixed()
    exact = corners(PaperCamera())
    for _ in range(3):
        camera.update(exact)
    strayed = {**exact, 12: exact[12] + 4.0}
    moved = camera.update(strayed)
    assert "reference marker 12 by 5.7 px" in moved.event
    for _ in range(3):
        after = camera.update(strayed)
        assert (after.problem, after.event) == ("", "")
    assert after.pose.position == pytest.approx(SETTINGS.position, abs=1e-5)


def test_one_visible_marker_does_not_decide_whether_it_or_the_camera_moved():
    camera = fixed()
    exact = corners(PaperCamera())
    camera.update(exact)
    moved = camera.update({10: exact[10] + 4.0})
    assert moved.pose is None
    assert "10 by 5.7 px" in moved.event
    for text in (moved.event, moved.problem):
        assert re.search("camera.* or .*markers", text)


@pytest.mark.parametrize("images_before", [2, 130])
def test_a_misplaced_marker_that_appears_later_is_reported_with_every_image(images_before):
    """The pose without this marker is not used again, and the last estimate with it is not the 128th image's."""
    camera = FixedCamera(MISPLACED, CAMERA)
    others, everything = corners(PaperCamera(), 11), corners(PaperCamera())
    for _ in range(images_before):
        assert camera.update(others).pose is not None
    for _ in range(6):
        rejected = camera.update(everything)
        assert rejected.pose is None
        assert "0.9 mm" in rejected.problem


def test_a_rejected_pose_is_found_again_without_the_marker_that_moved():
    camera = FixedCamera(MISPLACED, CAMERA)
    exact = corners(PaperCamera())
    for _ in range(3):
        assert camera.update(exact).pose is None
    removed = {**exact, 11: exact[11] + 4.0}
    assert "11 by 5.7 px" in camera.update(removed).event
    assert camera.update(removed).pose.position == pytest.approx(SETTINGS.position, abs=1e-5)


def test_without_a_reference_marker_nothing_is_accepted():
    camera = fixed()
    camera.update(corners(PaperCamera()))
    assert "no reference marker in view" in camera.update({}).problem
    assert (
        camera.update(corners(PaperCamera(), 11, 12, 13)).problem == ""
    )  # one is enough for the check
