# SPDX-License-Identifier: Apache-2.0
"""The setup file: its content, and one line for each error in it."""

from pathlib import Path

import pytest

from worm_driver.driver_errors import SetupError
from worm_driver.tracking.tracker_setup import load_setup

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


@pytest.fixture
def write(tmp_path: Path):
    def written(text: str) -> Path:
        path = tmp_path / "tracker.yaml"
        path.write_text(text)
        return path

    return written


def test_a_good_one(write):
    path = write(GOOD)
    setup = load_setup(path)
    assert setup.camera_info == str(path.with_name("camera.yaml"))
    assert setup.reference == {10: (0.0, 0.0, 0.06), 11: (0.3, 0.0, 0.06)}
    assert (setup.front.number, setup.front.offset) == (1, -0.004)
    assert (setup.rate, setup.delay, setup.origin) == (30.0, 0.0, 0.0)
    april = load_setup(write(GOOD.replace("DICT_4X4_50", "DICT_APRILTAG_36h11")))
    assert april.dictionary == "DICT_APRILTAG_36h11"


@pytest.mark.parametrize(
    ("old", "new", "facts"),
    [
        ("rate_hz: 30.0", "rate: 30.0", ["rate", "rate_hz"]),
        ("  11: [0.30, 0.0, 0.06]\n", "", ["reference", "2", "1"]),
        ("marker_size_m: 0.020", "marker_size_m: 20", ["marker_size_m", "0.5", "20"]),
        ("marker_size_m: 0.020", "marker_size_m: 0", ["marker_size_m", "0"]),
        ("[0.30, 0.0, 0.06]", "[300, 0.0, 60]", ["reference", "11", "20", "300"]),
        ("[0.30, 0.0, 0.06]", "[0.30, 0.0, 60]", ["reference", "11", "3", "60"]),
        ("offset_m: -0.004", "offset_m: -4", ["front", "offset_m", "-0.5", "-4"]),
        ("z_m: 0.0", "z_m: 15", ["module_line", "z_m", "3", "15"]),
        ("[0.30, 0.0, 0.06]", "[0.01, 0.0, 0.06]", ["10", "11", "0.01 m", "0.02 m"]),
        ("[0.30, 0.0, 0.06]", "[0.30, 0.06]", ["reference", "11"]),
        ("id: 1", "id: 0", ["rear", "front", "marker 0"]),
        ("id: 1", "id: 10", ["marker 10", "front", "reference"]),
        ("id: 1", "id: 50", ["50", "DICT_4X4_50", "49"]),
        ("DICT_4X4_50", "DICT_4X4", ["dictionary", "'DICT_4X4'", "DICT_4X4_"]),
        ("camera_info: camera.yaml\n", "", ["camera_info"]),
        ("rate_hz: 30.0", "delay_s: -1.0", ["delay_s", "0", "-1"]),
    ],
)
def test_an_invalid_setup_is_rejected_in_one_line(write, old, new, facts):
    assert old in GOOD
    path = write(GOOD.replace(old, new))
    with pytest.raises(SetupError) as rejected:
        load_setup(path)
    message = str(rejected.value)
    assert "\n" not in message
    assert message.startswith(str(path.parent))
    assert [fact for fact in facts if fact not in message.removeprefix(str(path))] == []
