# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the driver. Every message names the problem; where a person can do something, also the remedy."""


class DriverError(Exception):
    """Base class of all errors that the driver detects."""


class ConfigurationError(DriverError):
    """The driver cannot be configured or activated: an invalid parameter, an unfit device, or another driver."""


class RejectedError(DriverError):
    """The driver rejects a command: it is outside the robot's limits, or not permitted now."""


class StoppedError(DriverError):
    """The operation failed, and the robot holds. A stop interrupted or forbids the operation, or it took too long."""


class ReleaseError(DriverError):
    """The torque of a servo stays on, or the servo did not confirm that its torque is off."""


class HomingError(DriverError):
    """Homing is not possible now, or is required because the cable length is unknown or out of its range."""


class BusError(DriverError):
    """An exchange on the servo bus failed."""


class PortError(BusError):
    """The serial port is missing, locked, or was unplugged."""


class NoReplyError(BusError):
    """A servo gave no usable answer in time."""


class CorruptReplyError(BusError):
    """An answer is damaged, or disagrees with another answer or with the value written before."""


class StatusError(BusError):
    """A servo answered with an error number (Protocol 2.0: bits 6 to 0 of the error byte of a status packet)."""

    def __init__(self, message: str, number: int):
        super().__init__(message)
        self.number = number

    @property
    def is_noise(self) -> bool:
        """True if noise corrupted the request. The servo did not execute the request, so it may be repeated."""
        return self.number == 3


class PowerSensorError(DriverError):
    """The power sensor or its I2C bus is missing or unusable, or the sensor does not answer."""


class TrackingError(DriverError):
    """Base class of the tracker's exceptions."""


class SetupError(TrackingError):
    """Invalid setup file or calibration."""


class ImageError(TrackingError):
    """Unreadable image, video or camera."""


class PoseError(TrackingError):
    """Camera pose that cannot be determined from the visible reference markers."""
