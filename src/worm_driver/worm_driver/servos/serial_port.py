# SPDX-License-Identifier: Apache-2.0
"""What Linux has to say about a serial port: its FTDI latency timer, its locks, and why it cannot be opened."""

import contextlib
import errno
import fcntl
import os
import stat
import termios
from pathlib import Path

_SYSFS = Path("/sys/bus/usb-serial/devices")
#: majors of the slave side of pseudo-terminals (Linux, Documentation/admin-guide/devices.txt)
_PTY_MAJORS = range(136, 144)


def latency_timer_ms(port: str, sysfs: Path = _SYSFS) -> int | None:
    """The latency timer of the USB adapter behind a port, ms; None where it has none (a UART, a pty).

    An FTDI adapter holds answers back for that long: 16 ms by default, 1 ms is what 100 Hz needs.
    """
    try:
        return int(latency_timer_path(port, sysfs).read_text())
    except (OSError, ValueError):
        return None


def latency_timer_path(port: str, sysfs: Path = _SYSFS) -> Path:
    """Where that number is, ms, to be read and written."""
    return sysfs / Path(port).resolve().name / "latency_timer"


def refuse_other_openers(descriptor: int) -> None:
    """Makes the kernel refuse further opens of a tty, by programs that know no lock file too.

    A pseudo-terminal is left out: the mark outlives its opener there, as the other side holds it open.
    """
    if os.major(os.fstat(descriptor).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def admit_other_openers(descriptor: int) -> None:
    """Takes the mark of refuse_other_openers back."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCNXCL)


def explain_open_failure(port: str, error: Exception) -> str:
    """One line on why a port could not be opened, with the remedy."""
    number = getattr(error, "errno", None)
    if not Path(port).exists():
        return (
            f"servo bus {port} does not exist: plug the adapter in, install the udev rule "
            "(99-worm.rules makes /dev/worm_bus), or set the parameter port"
        )
    if not stat.S_ISCHR(Path(port).stat().st_mode):
        return f"servo bus {port} is no serial device: set the parameter port"
    if isinstance(error, PermissionError) or number == errno.EACCES:
        return (
            f"no permission for servo bus {port}: sudo usermod -aG dialout $USER, then log in again"
        )
    if number in (errno.EBUSY, errno.EWOULDBLOCK) or "exclusively lock" in str(error):
        return f"servo bus {port} is in use by another program: stop it (lsof {port} names it)"
    return f"servo bus {port} cannot be opened: {error}"
