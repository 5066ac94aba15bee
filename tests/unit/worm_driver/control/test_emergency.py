# SPDX-License-Identifier: Apache-2.0
"""The emergency stop, which outlasts its driver."""

from pathlib import Path

from worm_driver.control.emergency import EmergencyLatch, state_folder


def test_the_emergency_stop_outlasts_its_driver_for_its_robot_alone(tmp_path: Path):
    first = EmergencyLatch(tmp_path / "state")
    assert first.adopt("/dev/worm_bus") == ""
    assert first.why_not_start() == ""
    first.set(True)
    for port, on in (("/dev/worm_bus", True), ("/dev/ttyUSB3", False)):
        later = EmergencyLatch(tmp_path / "state")
        later.adopt(port)
        assert later.on == on
    assert "emergency_stop off" in first.why_not_start()
    first.set(False)
    later = EmergencyLatch(tmp_path / "state")
    later.adopt("/dev/worm_bus")
    assert not later.on


def test_one_that_comes_before_the_robot_is_known_is_kept(tmp_path: Path):
    latch = EmergencyLatch(tmp_path)
    latch.set(True)
    latch.adopt("/dev/worm_bus")
    assert latch.on
    assert len(list(tmp_path.iterdir())) == 1


def test_one_that_cannot_be_kept_holds_all_the_same_and_that_is_said(tmp_path: Path):
    (tmp_path / "file").touch()
    latch = EmergencyLatch(tmp_path / "file" / "state")
    latch.adopt("/dev/worm_bus")
    assert "the next driver will not know" in latch.set(True)
    assert latch.on


def test_where_it_is_kept():
    assert state_folder({"STATE_DIRECTORY": "/var/lib/worm"}) == Path("/var/lib/worm")
    assert state_folder({"XDG_STATE_HOME": "/s", "HOME": "/h"}) == Path("/s/worm_driver")
    assert state_folder({"HOME": "/h"}) == Path("/h/.local/state/worm_driver")
