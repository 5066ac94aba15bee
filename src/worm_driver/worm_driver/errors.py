# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the driver. Every message names the problem, the place and the remedy."""


class DriverError(Exception):
    """Base class of all errors that the driver detects."""


class ConfigurationError(DriverError):
    """A parameter is invalid, or a device does not match the parameters."""


class LimitError(DriverError):
    """A gait or a goal is outside the robot's limits."""


class StoppedError(DriverError):
    """A stop interrupted the operation."""


class ReleaseError(DriverError):
    """A servo did not confirm that its torque is off."""


class HomingError(DriverError):
    """The turn count of a cable servo is unknown, and so is its cable length."""


class BusError(DriverError):
    """An exchange on the servo bus failed."""


class PortError(BusError):
    """The serial port is missing, locked, or was unplugged."""


class NoReplyError(BusError):
    """A servo did not answer in time."""


class CorruptReplyError(BusError):
    """The CRC, length or form of an answer is wrong."""


class StatusError(BusError):
    """A servo answered with an error number (Protocol 2.0, status packet, bits 6-0)."""

    def __init__(self, message: str, number: int):
        super().__init__(message)
        self.number = number

    @property
    def is_noise(self) -> bool:
        """True if noise corrupted the request. The servo did not execute it, so it may be repeated."""
        return self.number == 3


class PowerSensorError(DriverError):
    """The power sensor is missing, is another chip, or does not answer."""
