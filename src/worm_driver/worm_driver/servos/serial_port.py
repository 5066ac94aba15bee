# SPDX-License-Identifier: Apache-2.0
"""Serial port in Linux: FTDI latency timer, exclusive use, and reasons why a port cannot be opened."""

import contextlib
import errno
import fcntl
import os
import stat
import termios
from pathlib import Path

from worm_driver.driver_errors import ConfigurationError

_SYSFS = Path("/sys/bus/usb-serial/devices")
#: Answers per cycle that an adapter may delay: those of the state and of the health register.
_ANSWERS = 2
#: Major device numbers of the slave side of pseudo-terminals (Linux, Documentation/admin-guide/devices.txt).
_PTY_MAJORS = range(136, 144)


def latency_timer_ms(port: str, sysfs: Path = _SYSFS) -> int | None:
    """Return the latency timer (ms) of a port's USB adapter; None for a port without timer (UART, pseudo-terminal).

    An FTDI adapter delays answers by up to this time. Its default, 16 ms, is too long for a rate of 100 Hz.
    """
    try:
        return int(latency_timer_path(port, sysfs).read_text())
    except (OSError, ValueError):
        return None


def latency_timer_path(port: str, sysfs: Path = _SYSFS) -> Path:
    """Return the path of the file that holds the latency timer in ms, for reading and writing."""
    return sysfs / Path(port).resolve().name / "latency_timer"


def require_latency(port: str, latency: float, period: float) -> None:
    """Check that the latency of a port's adapter (s) leaves time for the answers of a control cycle (period in s)."""
    if _ANSWERS * latency >= period:
        raise ConfigurationError(
            f"the latency timer of {port} is {latency * 1e3:.0f} ms, too long for {1.0 / period:g} Hz: install the "
            f"udev rule (99-worm.rules), or echo 1 | sudo tee {latency_timer_path(port)}"
        )


def why_no_port(port: str) -> str:
    """Return why an existing path cannot be a servo bus, with the remedy; empty if it can be one, or does not exist."""
    try:
        status = Path(port).stat()
    except OSError:
        return ""  # opening it reports the reason
    remedy = (
        "set the parameter port to the adapter's device (/dev/worm_bus, or see /dev/serial/by-id)"
    )
    if not stat.S_ISCHR(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a file, not a device"
        return f"servo bus {port} is {kind}: {remedy}"
    return ""


def open_exclusively(descriptor: int) -> None:
    """Make the kernel reject further opens of a tty, also by programs that ignore lock files.

    Processes with CAP_SYS_ADMIN, such as those of root, can still open it.

    The function does nothing for a pseudo-terminal. The other side keeps a pseudo-terminal open, so the kernel would
    still reject opens after this process has ended.
    """
    if os.major(os.fstat(descriptor).st_rdev) not in _PTY_MAJORS:
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def end_exclusive_use(descriptor: int) -> None:
    """Undo `open_exclusively`."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCNXCL)


def explain_open_failure(port: str, error: Exception) -> str:
    """Return why a port could not be opened, with the remedy."""
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
