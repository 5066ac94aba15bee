# SPDX-License-Identifier: Apache-2.0
"""The emergency stop: the robot it belongs to, and its files."""

from pathlib import Path

import pytest

from worm_driver.control.emergency import EmergencyLatch, latch_names, state_folder

SERVOS = (1, 11, 12)


@pytest.fixture
def device(tmp_path: Path) -> Path:
    """A serial device under two names."""
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "worm_bus").symlink_to("ttyUSB0")
    return tmp_path


def latch(folder: Path, namespace: str, port: object, servos: tuple[int, ...] = SERVOS):
    made = EmergencyLatch(folder / "state")
    assert made.adopt(latch_names(namespace, servos, str(port))) == ""
    return made


@pytest.mark.parametrize(
    ("namespace", "port", "servos"),
    [
        ("/worm", "worm_bus", SERVOS),
        ("/worm", "ttyUSB0", SERVOS),  # the same device under its other name
        ("/worm", "ttyUSB7", SERVOS),  # the robot on another device
        ("/worm", "ttyUSB7", (12, 11, 1)),
        ("/other", "ttyUSB0", SERVOS),  # the device in another namespace
        ("/", "worm_bus", (2,)),
    ],
)
def test_the_next_driver_of_the_robot_finds_the_stop_by_whatever_name(
    device: Path, namespace: str, port: str, servos: tuple[int, ...]
):
    first = latch(device, "/worm", device / "worm_bus")
    assert first.why_not_start() == ""
    assert first.latch() == ""
    assert "reset_emergency_stop" in first.why_not_start()
    later = latch(device, namespace, device / port, servos)
    assert later.on
    assert later.reset() == ""
    assert not latch(device, namespace, device / port, servos).on


def test_another_robot_does_not_find_it_and_its_reset_does_not_clear_it(device: Path):
    latch(device, "/worm", device / "worm_bus").latch()
    assert not latch(device, "/other", device / "ttyUSB3").on
    neighbour = latch(device, "/other", device / "ttyUSB0")  # got the number of the device
    assert neighbour.on
    neighbour.reset()
    assert latch(device, "/worm", device / "ttyUSB5").on


def test_a_virtual_robot_shares_no_stop_with_a_robot_of_its_namespace(device: Path, terminal: str):
    (device / "servo_bus").symlink_to(terminal)
    latch(device, "/worm", device / "servo_bus").latch()
    assert not latch(device, "/worm", device / "worm_bus").on
    (device / "other_name").symlink_to("servo_bus")
    assert latch(device, "/worm", device / "other_name").on
    assert latch(device, "/other", device / "other_name").on
    (device / "another_robot").symlink_to(terminal)  # got the number of the terminal
    assert not latch(device, "/worm", device / "another_robot").on


def test_a_stop_that_comes_before_the_robot_is_known_is_stored(tmp_path: Path):
    made = EmergencyLatch(tmp_path)
    made.latch()
    made.adopt(["one", "two"])
    assert made.on
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "two"]


def test_the_stop_of_a_port_that_a_parameter_no_longer_names_is_left_to_its_robot(tmp_path: Path):
    EmergencyLatch(tmp_path).adopt(["one"])
    (tmp_path / "one").touch()
    made = EmergencyLatch(tmp_path)
    made.adopt(["one"])
    assert made.on
    made.adopt(["two"])
    assert not made.on
    assert [path.name for path in tmp_path.iterdir()] == ["one"]


def test_a_stop_that_cannot_be_stored_holds_all_the_same_and_that_is_reported(tmp_path: Path):
    (tmp_path / "file").touch()
    made = EmergencyLatch(tmp_path / "file" / "state")
    made.adopt(["one"])
    report = made.latch()
    assert str(made.folder) in report
    assert "WORM_STATE_DIRECTORY" in report
    assert made.on


def test_a_stop_whose_file_cannot_be_removed_stays_on(tmp_path: Path):
    made = EmergencyLatch(tmp_path)
    made.adopt(["one"])
    (tmp_path / "one").mkdir()  # in place of a file, so that the removal fails for root, too
    made.adopt(["one"])
    assert made.on
    assert "stays on" in made.reset()
    assert made.on


def test_one_folder_for_the_service_and_a_login_shell(tmp_path: Path):
    shared, home = tmp_path / "worm", {"HOME": "/h"}
    assert state_folder(home, shared) == Path("/h/.local/state/worm_driver")
    assert state_folder({"XDG_STATE_HOME": "/s"}, shared) == Path("/s/worm_driver")
    shared.mkdir()
    service = {"STATE_DIRECTORY": str(shared), "HOME": "/nonexistent"}
    assert state_folder(service, shared) == shared
    assert state_folder(home, shared) == state_folder({"XDG_STATE_HOME": "/s"}, shared) == shared
    assert state_folder({**service, "WORM_STATE_DIRECTORY": "/t"}, shared) == Path("/t")
