# SPDX-License-Identifier: Apache-2.0
"""16-bit registers of a device on the I2C bus, through smbus2. No other module imports smbus2.

SMBus transmits the low byte of a word first; the chips of this robot send the high byte first. This module swaps the
bytes in both directions. Only one thread may use a bus, because smbus2 has no lock.
"""

import contextlib
import errno
import stat
from dataclasses import dataclass
from pathlib import Path

import smbus2

from worm_driver.driver_errors import PowerSensorError
from worm_driver.power.socket_smbus import SocketSMBus


@dataclass
class I2CDevice:
    """Device with big-endian 16-bit registers at an address of a bus.

    Attributes:
        bus: open bus.
        bus_name: name under which the bus was opened.
        address: 7-bit address.
    """

    bus: smbus2.SMBus | SocketSMBus
    bus_name: str
    address: int

    def read(self, register: int) -> int:
        """Return the content of a register, unsigned. Raises PowerSensorError."""
        try:
            return swap(self.bus.read_word_data(self.address, register))
        except OSError as error:
            raise PowerSensorError(self._explain(error)) from error

    def write(self, register: int, value: int) -> None:
        """Set a register. Raises PowerSensorError."""
        try:
            self.bus.write_word_data(self.address, register, swap(value))
        except OSError as error:
            raise PowerSensorError(self._explain(error)) from error

    def close(self) -> None:
        """Close the bus. Ignore errors, for example of an unplugged adapter."""
        with contextlib.suppress(OSError):
            self.bus.close()

    def _explain(self, error: OSError) -> str:
        where = f"I2C device 0x{self.address:02X} on bus {self.bus_name}"
        remedy = {
            errno.EREMOTEIO: "does not acknowledge: check its power, wiring and address (i2cdetect)",
            errno.ENXIO: "does not acknowledge: check its power, wiring and address (i2cdetect)",
            errno.ETIMEDOUT: "timed out: a device may block the bus. Switch its power off and on",
            errno.EBUSY: "is in use by a kernel driver: unbind ina2xx (hwmon)",
        }.get(error.errno or 0, f"failed: {error}")
        return f"{where} {remedy}"


def swap(word: int) -> int:
    """Return a word with its two bytes swapped."""
    return (word & 0xFF) << 8 | word >> 8


def open_device(bus: str, address: int) -> I2CDevice:
    """Open the device at an address.

    Args:
        bus: number ("1"), device ("/dev/i2c-1"), or Unix socket of a virtual robot.
        address: 7-bit address.
    """
    try:
        return I2CDevice(_open_bus(bus), bus, address)
    except FileNotFoundError as error:
        raise PowerSensorError(
            f"I2C bus {bus} does not exist: enable I2C (dtparam=i2c_arm=on), or set the parameter i2c_bus"
        ) from error
    except PermissionError as error:
        raise PowerSensorError(
            f"no permission for I2C bus {bus}: sudo usermod -aG i2c $USER, then log in again"
        ) from error
    except OSError as error:
        raise PowerSensorError(f"I2C bus {bus} cannot be opened: {error}") from error


def exists(bus: str) -> bool:
    """Return True if a bus, as in `open_device`, can be opened or is not wanted ("none" or empty)."""
    if bus in ("", "none"):
        return True
    try:
        _open_bus(bus).close()
    except OSError:
        return False
    return True


def _open_bus(bus: str) -> smbus2.SMBus | SocketSMBus:
    if bus.isdecimal():
        return smbus2.SMBus(int(bus))
    if stat.S_ISSOCK(Path(bus).stat().st_mode):
        return SocketSMBus(bus)
    return smbus2.SMBus(bus)
