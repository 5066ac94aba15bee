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
#: majors of /dev/null and its kind, of virtual consoles and serial ports, and of /dev/tty, /dev/console and /dev/ptmx
_MEMORY_MAJORS = (1,)
_CONSOLE_MAJORS = (4, 5)
#: minor from which on a device of a console's major is a serial port
_SERIAL_MINORS = 64


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


def why_no_port(port: str) -> str:
    """One line on why a path that exists can be no servo bus, with the remedy; empty where it may be one."""
    try:
        status = Path(port).stat()
    except OSError:
        return ""  # opening it says why
    remedy = (
        "set the parameter port to the adapter's device (/dev/worm_bus, or see /dev/serial/by-id)"
    )
    if not stat.S_ISCHR(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a file, not a device"
        return f"servo bus {port} is {kind}: {remedy}"
    if os.major(status.st_rdev) in _MEMORY_MAJORS:
        return f"servo bus {port} is no serial device: {remedy}"
    if os.major(status.st_rdev) in _CONSOLE_MAJORS and os.minor(status.st_rdev) < _SERIAL_MINORS:
        return f"servo bus {port} is a console of this computer: {remedy}"
    if status.st_rdev in _own_terminals():
        return f"servo bus {port} is the terminal that this runs in: {remedy}"
    return ""


def _own_terminals() -> set[int]:
    """Device numbers of the terminals that this process reads from and writes to, or belongs to."""
    terminals = set()
    for descriptor in (0, 1, 2):
        with contextlib.suppress(OSError):
            if os.isatty(descriptor):
                terminals.add(os.fstat(descriptor).st_rdev)
    with contextlib.suppress(OSError):
        terminals.add(Path("/dev/tty").stat().st_rdev)
    return terminals


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
    if reason := why_no_port(port):
        return reason
    if isinstance(error, PermissionError) or number == errno.EACCES:
        return (
            f"no permission for servo bus {port}: sudo usermod -aG dialout $USER, then log in again"
        )
    if number in (errno.EBUSY, errno.EWOULDBLOCK) or "exclusively lock" in str(error):
        return f"servo bus {port} is in use by another program: stop it (lsof {port} names it)"
    return f"servo bus {port} cannot be opened: {error}"
