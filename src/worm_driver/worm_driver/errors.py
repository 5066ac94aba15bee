# SPDX-License-Identifier: Apache-2.0
"""The exceptions of the driver, one tree: every message says what, where, and what to do."""


class DriverError(Exception):
    """Anything that the driver knows can go wrong."""


class ConfigurationError(DriverError):
    """A parameter, or a device that is not what the parameters say."""


class LimitError(DriverError):
    """A gait or a goal outside the robot's limits."""


class StoppedError(DriverError):
    """The service stop came in between."""


class ReleaseError(DriverError):
    """A servo did not say that its torque is off."""


class HomingError(DriverError):
    """The turn count of a cable servo is not known, so its cable length is not either."""


class BusError(DriverError):
    """The servo bus failed an exchange."""


class PortError(BusError):
    """The serial port is missing, locked, or was unplugged."""


class NoReplyError(BusError):
    """A servo did not answer within its time."""


class CorruptReplyError(BusError):
    """An answer came, but its CRC, length or form is wrong."""


class StatusError(BusError):
    """A servo answered with an error number (Protocol 2.0, status packet, bits 6-0)."""

    def __init__(self, message: str, number: int):
        super().__init__(message)
        self.number = number

    @property
    def is_noise(self) -> bool:
        """Whether the line garbled the question, so that it was not carried out and may be repeated."""
        return self.number == 3


class PowerSensorError(DriverError):
    """The power sensor is missing, is another chip, or did not answer."""
