# SPDX-License-Identifier: Apache-2.0
"""INA219 power sensor (TI SBOS448G), with checks of every sample.

The driver computes the current from the shunt voltage and the shunt's resistance, without the calibration register. The
driver still writes this register, for two reasons: the chip's overflow bit depends on its value, and a value of 0
reveals a brown-out. Every sample includes a check of the calibration and the configuration register. A corrupted
configuration would change the range of the shunt voltage without any other sign.
"""

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from worm_driver.driver_errors import ConfigurationError, PowerSensorError
from worm_driver.power.i2c import I2CDevice

CONFIGURATION, SHUNT, BUS, POWER, CALIBRATION = 0, 1, 2, 3, 5  # register addresses

RESET = 0x8000
POWER_ON_CONFIGURATION = 0x399F
#: bus range 32 V, shunt range +-320 mV, mean of 8 conversions each (8.5 ms for both values), continuous
RUNNING_CONFIGURATION = 0b0011_1101_1101_1111

SHUNT_LSB_V = 10e-6
BUS_LSB_V = 4e-3
#: absolute value of the raw shunt voltage at the ends of the range +-320 mV
SHUNT_FULL_SCALE = 32_000
#: smallest shunt voltage at the largest current, V, at which the calibration fits into its 16 bits: 0.02048, rounded up
_LEAST_FULL_SCALE_V = 0.0205

#: number of consecutive samples with identical bits at which the chip counts as frozen. With a quiet supply a few
#: samples are identical, but seldom so many at a resolution of 4 mV and 0.1 mA (shunt of 0.1 ohm).
FROZEN = 100

#: mean current of servos at rest below which it must have the wrong sign, A. It is twice the largest offset of the chip
#: (0.1 mV) with a shunt of 0.01 ohm. With larger shunts, the offset is a smaller current.
_REVERSED_A = -0.02

_OVERFLOW_BIT = 0b01
_READY_BIT = 0b10


class SampleStatus(enum.Enum):
    """Status of a sample: valid, or the reason for missing values."""

    VALID = "valid"
    OVERFLOW = "overflow"
    NOT_READY = "not ready"  # no new conversion, or the chip is frozen
    BUS_ERROR = "bus error"
    SENSOR_RESET = "sensor reset"  # the chip had lost its settings; the driver set it up again


@dataclass(frozen=True)
class PowerSample:
    """Sample of the sensor. The values are NaN unless the status is VALID.

    Attributes:
        time: time of the sample, s, monotonic.
        status: VALID, or the reason for missing values.
        bus_voltage: voltage of the supply, V.
        current: current through the shunt, A.
    """

    time: float
    status: SampleStatus
    bus_voltage: float = math.nan
    current: float = math.nan

    @property
    def power(self) -> float:
        """Source power, W."""
        return self.bus_voltage * self.current


@dataclass
class INA219:
    """INA219 sensor and its shunt.

    Attributes:
        device: I2C device of the chip.
        shunt_resistance: resistance of the shunt, ohm.
        calibration: value of the calibration register, see `calibration_for`.
    """

    device: I2CDevice
    shunt_resistance: float
    calibration: int
    _bits: tuple[int, int] = field(default=(-1, -1), init=False)
    _repeats: int = field(default=0, init=False)

    def start(self) -> None:
        """Reset the chip, check its type, and set it up."""
        self.device.write(CONFIGURATION, RESET)
        configuration = self.device.read(CONFIGURATION)
        if configuration != POWER_ON_CONFIGURATION:
            raise self.other_chip(configuration)
        self.set_up()

    def other_chip(self, configuration: int) -> PowerSensorError:
        """Return the error about a chip with another configuration than an INA219 has after a reset."""
        return PowerSensorError(
            f"the device 0x{self.device.address:02X} on I2C bus {self.device.bus_name} is no INA219, or its adapter "
            f"swaps bytes: its configuration is 0x{configuration:04X}, not 0x399F as after a reset; check the "
            "parameter i2c_address"
        )

    def set_up(self) -> None:
        """Write the settings and check them. Raises PowerSensorError."""
        self.device.write(CONFIGURATION, RUNNING_CONFIGURATION)
        self.device.write(CALIBRATION, self.calibration)
        if not self.is_set_up():
            raise PowerSensorError("the INA219 loses its settings: check its supply")

    def is_set_up(self) -> bool:
        """Return True if the chip has its settings. Raises PowerSensorError."""
        return (
            self.device.read(CALIBRATION) == self.calibration
            and self.device.read(CONFIGURATION) == RUNNING_CONFIGURATION
        )

    def sample(self, time: float) -> PowerSample:
        """Return a sample with the stamp ``time`` (s, monotonic). If the chip lost its settings, set it up again."""
        try:
            return self._sample(time)
        except PowerSensorError:
            return PowerSample(time, SampleStatus.BUS_ERROR)

    def _sample(self, time: float) -> PowerSample:
        bus = self.device.read(BUS)
        shunt = _signed(self.device.read(SHUNT))
        if not self.is_set_up():  # This check comes after the values were read, so it covers them.
            self.set_up()
            return PowerSample(time, SampleStatus.SENSOR_RESET)
        if not bus & _READY_BIT:
            return PowerSample(time, SampleStatus.NOT_READY)
        self.device.read(POWER)  # clears the ready bit
        return self._judged(time, bus, shunt)

    def look(self, time: float) -> PowerSample:
        """Return a sample with the stamp ``time`` (s) like `sample`, from a chip that keeps its settings as they are.

        The chip is only read, without an effect on another reader. Call this method at most once per conversion.
        """
        try:
            return self._judged(time, self.device.read(BUS), _signed(self.device.read(SHUNT)))
        except PowerSensorError:
            return PowerSample(time, SampleStatus.BUS_ERROR)

    def _judged(self, time: float, bus: int, shunt: int) -> PowerSample:
        """Return the sample of a bus voltage and a shunt voltage, both raw."""
        if bus & _OVERFLOW_BIT or abs(shunt) >= SHUNT_FULL_SCALE:
            return PowerSample(time, SampleStatus.OVERFLOW)
        if self._is_frozen((bus, shunt)):
            return PowerSample(time, SampleStatus.NOT_READY)
        current = shunt * SHUNT_LSB_V / self.shunt_resistance
        return PowerSample(time, SampleStatus.VALID, (bus >> 3) * BUS_LSB_V, current)

    def _is_frozen(self, bits: tuple[int, int]) -> bool:
        """Return True if the bits of the last FROZEN samples are identical."""
        self._repeats = self._repeats + 1 if bits == self._bits else 1
        self._bits = bits
        return self._repeats >= FROZEN


def reversed_current(samples: Sequence[PowerSample]) -> str:
    """Return a message if the mean current of valid samples of a robot at rest is negative, else an empty string."""
    current = math.fsum(sample.current for sample in samples) / len(samples)
    if current >= _REVERSED_A:
        return ""
    return (
        f"the current at rest is {current:.2f} A, and servos at rest cannot be a source: exchange IN+ and IN- of the "
        "INA219"
    )


def calibration_for(shunt_resistance: float, max_current: float) -> int:
    """Return the value of the calibration register for a shunt (ohm) and the largest current (A) without overflow.

    Cal = trunc(0.04096 / (Current_LSB R)) with Current_LSB = max_current / 32768 and the resistance R of the shunt
    (SBOS448G). Bit 0 is always 0.
    """
    if not (shunt_resistance > 0.0 and max_current > 0.0):
        raise ConfigurationError("shunt_resistance_ohm and max_current_a must be positive")
    if max_current * shunt_resistance > 0.32 * (1.0 + 1e-9):
        raise ConfigurationError(
            f"{max_current:g} A through {shunt_resistance:g} ohm exceeds the INA219's 320 mV: "
            f"use at most {0.32 / shunt_resistance:g} A, or a smaller shunt"
        )
    if max_current * shunt_resistance < _LEAST_FULL_SCALE_V * (1.0 - 1e-9):
        raise ConfigurationError(
            f"max_current_a {max_current:g} is too small for the INA219 with {shunt_resistance:g} ohm: "
            f"use at least {_LEAST_FULL_SCALE_V / shunt_resistance:g} A, or a larger shunt"
        )
    return int(0.04096 / (max_current / 32768 * shunt_resistance)) & 0xFFFE


def _signed(word: int) -> int:
    return word - 0x1_0000 if word & 0x8000 else word
