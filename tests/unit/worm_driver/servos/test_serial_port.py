# SPDX-License-Identifier: Apache-2.0
import array
import errno
import fcntl
import os

import pytest

from worm_driver.driver_errors import ConfigurationError
from worm_driver.servos import serial_port
from worm_driver.servos.servo_bus import ServoBus

TIOCGEXCL = 0x80045440


def _exclusive(descriptor: int) -> bool:
    state = array.array("i", [0])
    fcntl.ioctl(descriptor, TIOCGEXCL, state)
    return bool(state[0])


def test_the_latency_timer_is_found_behind_a_symbolic_link(tmp_path):
    sysfs = tmp_path / "sysfs"
    (sysfs / "ttyUSB7").mkdir(parents=True)
    (sysfs / "ttyUSB7" / "latency_timer").write_text("16\n")
    device = tmp_path / "ttyUSB7"
    device.touch()
    link = tmp_path / "worm_bus"
    link.symlink_to(device)
    assert serial_port.latency_timer_ms(str(link), sysfs) == 16


def test_a_port_without_a_latency_timer_has_none(tmp_path):
    assert serial_port.latency_timer_ms("/dev/null", tmp_path) is None


def test_a_pseudo_terminal_is_not_marked_and_other_openers_are_admitted_again(terminal):
    slave = os.open(terminal, os.O_RDWR | os.O_NOCTTY)
    serial_port.open_exclusively(slave)
    assert not _exclusive(slave)
    fcntl.ioctl(slave, 0x540C)  # TIOCEXCL
    assert _exclusive(slave)
    serial_port.end_exclusive_use(slave)
    assert not _exclusive(slave)
    os.close(slave)


def test_each_failure_to_open_has_its_remedy(tmp_path, terminal):
    missing = str(tmp_path / "no")
    assert "udev rule" in serial_port.explain_open_failure(missing, FileNotFoundError())
    (tmp_path / "file").touch()
    file = str(tmp_path / "file")
    explain = serial_port.explain_open_failure
    assert "set the parameter port" in explain(file, OSError())
    assert "dialout" in explain(terminal, PermissionError(errno.EACCES, "no"))
    assert f"lsof {terminal}" in explain(terminal, OSError(errno.EWOULDBLOCK, "lock"))
    assert "bad fd" in explain(terminal, OSError(errno.EBADF, "bad fd"))


@pytest.mark.parametrize(
    ("name", "expected"), [("notes.txt", "a file, not a device"), (".", "a folder")]
)
def test_what_is_no_port_is_rejected_before_it_is_opened_in_one_line_with_the_remedy(
    tmp_path, name, expected
):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ConfigurationError, match=expected) as rejected:
        ServoBus.open(str(tmp_path / name), 1_000_000)
    assert "set the parameter port" in str(rejected.value)
    assert "\n" not in str(rejected.value)
