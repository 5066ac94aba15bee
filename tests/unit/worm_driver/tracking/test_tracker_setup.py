# SPDX-License-Identifier: Apache-2.0
"""The setup file: what it holds, and one line for each way in which it can be wrong."""

from pathlib import Path

import pytest
from camera_rig import SETTINGS, model_of

from worm_driver.tracking.camera_model import camera_info_text
from worm_driver.tracking.tracker_setup import load_setup
from worm_driver.tracking.tracking_errors import SetupError

GOOD = """\
dictionary: DICT_4X4_50
marker_size_m: 0.020
rear: {id: 0, offset_m: 0.0}
front: {id: 1, offset_m: -0.004}
module_line: {y_m: 0.0, z_m: 0.0}
reference:
  10: [0.00, 0.0, 0.06]
  11: [0.30, 0.0, 0.06]
camera_info: camera.yaml
rate_hz: 30.0
"""


REFERENCE = GOOD[GOOD.index("reference:") : GOOD.index("camera_info")]


@pytest.fixture
def write(tmp_path: Path):
    (tmp_path / "camera.yaml").write_text(camera_info_text("camera", model_of(SETTINGS)))

    def written(text: str) -> Path:
        path = tmp_path / "tracker.yaml"
        path.write_text(text)
        return path

    return written


def test_a_good_one(write):
    setup = load_setup(write(GOOD))
    assert setup.camera == model_of(SETTINGS)
    assert setup.reference == {10: (0.0, 0.0, 0.06), 11: (0.3, 0.0, 0.06)}
    assert (setup.front.number, setup.front.offset) == (1, -0.004)
    assert (setup.rate, setup.delay, setup.pose, setup.origin) == (30.0, 0.0, "fixed", 0.0)
    april = load_setup(write(GOOD.replace("DICT_4X4_50", "DICT_APRILTAG_36h11")))
    assert april.dictionary == "DICT_APRILTAG_36h11"


def test_the_calibration_may_come_with_the_images(write):
    assert load_setup(write(GOOD.replace("camera.yaml", "topic"))).camera is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("rate_hz: 30.0", "rate: 30.0", "unknown key 'rate'"),
        ("offset_m: 0.0}", "offset_m: 0.0, colour: red}", "rear: unknown key 'colour'"),
        ("  11: [0.30", "  10: [0.30", "line 8: .*10"),
        ("rate_hz: 30.0", "dictionary: DICT_4X4_50", "line 10: .*dictionary"),
        ("  11: [0.30, 0.0, 0.06]\n", "", "2 markers are needed, not 1"),
        ("marker_size_m: 0.020", "marker_size_m: 20", "in m, not mm .did you mean 0.02"),
        ("marker_size_m: 0.020", "marker_size_m: 0", "must be above 0"),
        ("[0.30, 0.0, 0.06]", "[300, 0.0, 60]", "11: x is 300 m: lengths are in m, not mm"),
        ("[0.30, 0.0, 0.06]", "[0.30, 0.0, 60]", "11: z is 60 m"),
        ("offset_m: -0.004", "offset_m: -4", "front: offset_m is -4 m"),
        ("z_m: 0.0", "z_m: 15", "module_line: z_m is 15 m"),
        ("[0.30, 0.0, 0.06]", "[0.01, 0.0, 0.06]", "0.01 m apart, closer than the 0.02 m"),
        ("[0.30, 0.0, 0.06]", "[0.30, 0.06]", r"11 must be \[x, y, z\]"),
        ("[0.30, 0.0, 0.06]", "[0.30, 0.0, .nan]", "must be a number"),
        ("id: 1", "id: 0", "same marker 0"),
        ("id: 1", "id: 10", "marker 10 is both front and a reference"),
        ("id: 1", "id: 50", "DICT_4X4_50 has 0 to 49"),
        ("id: 1", "id: true", "id: .*True"),
        ("DICT_4X4_50", "DICT_4X4", "'DICT_4X4'"),
        ("camera_info: camera.yaml\n", "", "camera_info .the camera's calibration.* is missing"),
        ("camera.yaml", "lost.yaml", "lost.yaml: No such file.*calibrate_camera"),
        ("rate_hz: 30.0", "delay_s: -1.0", "delay_s must not be negative"),
        ("rate_hz: 30.0", "pose: free", "pose must be one of fixed, each_image"),
        ("rate_hz: 30.0", "max_speed_m_s: 0", "max_speed_m_s must be above 0"),
        ("rear: {id: 0, offset_m: 0.0}", "rear: 0", "rear must be a mapping with id"),
        (REFERENCE, "reference: [10, 11]\n", "reference must map"),
        ("dictionary: DICT_4X4_50", "dictionary: [", "YAML"),
    ],
)
def test_a_wrong_one_is_refused_in_one_line(write, old, new, message):
    assert old in GOOD
    path = write(GOOD.replace(old, new))
    with pytest.raises(SetupError, match=message) as refused:
        load_setup(path)
    assert "\n" not in str(refused.value)
    assert str(path.parent) in str(refused.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(SetupError, match="No such file"):
        load_setup(tmp_path / "none.yaml")
