# SPDX-License-Identifier: Apache-2.0
import array
import errno
import fcntl
import os

from worm_driver.servos import serial_port

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


def test_other_openers_are_admitted_again():
    master, slave = os.openpty()
    fcntl.ioctl(slave, 0x540C)  # TIOCEXCL
    assert _exclusive(slave)
    serial_port.admit_other_openers(slave)
    assert not _exclusive(slave)
    os.close(master)
    os.close(slave)


def test_a_pseudo_terminal_is_not_marked():
    master, slave = os.openpty()
    serial_port.refuse_other_openers(slave)
    assert not _exclusive(slave)
    os.close(master)
    os.close(slave)


def test_each_failure_to_open_has_its_remedy(tmp_path):
    missing = str(tmp_path / "no")
    assert "udev rule" in serial_port.explain_open_failure(missing, FileNotFoundError())
    (tmp_path / "file").touch()
    file = str(tmp_path / "file")
    assert "no serial device" in serial_port.explain_open_failure(file, OSError())
    explain = serial_port.explain_open_failure
    assert "dialout" in explain("/dev/null", PermissionError(errno.EACCES, "no"))
    assert "lsof /dev/null" in explain("/dev/null", OSError(errno.EWOULDBLOCK, "lock"))
    assert "bad fd" in explain("/dev/null", OSError(errno.EBADF, "bad fd"))
