# SPDX-License-Identifier: Apache-2.0
"""INA219 power sensor at register level, and its I2C bus.

Each step of the virtual robot sets shunt and bus voltage (V). A conversion yields the mean voltage over its duration.
The integer arithmetic is that of the data sheet SBOS448G.
"""

import errno
import math
from dataclasses import dataclass
from random import Random

from worm_driver.power import socket_smbus as frames
from worm_driver.power.socket_smbus import Answer, Request
from worm_driver.virtual_robot.wire import faults
from worm_driver.virtual_robot.wire.faults import FaultBoard

CONFIGURATION, SHUNT, BUS, POWER, CURRENT, CALIBRATION = range(6)
POWER_ON_CONFIGURATION = 0x399F

_RESET_BIT = 0x8000
_CONVERSION_READY = 0x0002
_OVERFLOW = 0x0001
_SHUNT_LSB = 10e-6  # V per raw unit of the shunt voltage
_BUS_LSB = 4e-3  # V per raw unit of the bus voltage
_BUS_PIN_LIMIT = 26.0  # V, largest measurable bus voltage, also in the 32 V range
_BASE_TIMES = (84e-6, 148e-6, 276e-6, 532e-6)  # s, one conversion of 9, 10, 11, 12 bit
_RELEASED = 0xFF  # value of a bus that no device drives
_UNAVERAGED = 532e-6  # s, one 12-bit conversion


@dataclass(frozen=True)
class Converter:
    """Setting of a converter.

    Attributes:
        time: duration of a conversion with all its samples, s.
        samples: number of averaged samples.
        lost_bits: number of low bits that are always 0.
    """

    time: float
    samples: int
    lost_bits: int


def converter(field: int) -> Converter:
    """Return the setting that a 4-bit field of the configuration (BADC or SADC) selects."""
    if field & 0x8:
        samples = 1 << (field & 0x7)
        return Converter(_UNAVERAGED * samples, samples, 0)
    bits = field & 0x3
    return Converter(_BASE_TIMES[bits], 1, 3 - bits)


@dataclass(frozen=True)
class AdcNoise:
    """Standard deviations of the noise of one conversion without averaging, at the shunt and at the bus pin, V."""

    shunt: float
    bus: float


class Ina219:
    """INA219 chip with 16-bit raw registers. Times are in s and must not decrease.

    ``forced_overflow`` sets the overflow bit regardless of the arithmetic.
    """

    def __init__(self, noise: AdcNoise, random: Random) -> None:
        self._noise = noise
        self._random = random
        self._time = 0.0
        self.forced_overflow = False
        self.power_on()

    def power_on(self) -> None:
        """Reset all registers. Calibration is 0, so that current and power read 0."""
        self._registers = [POWER_ON_CONFIGURATION, 0, 0, 0, 0, 0]
        self._ready = False
        self._math_overflow = False
        self._restart()

    # --- the bus side -------------------------------------------------------------------------

    def read(self, register: int) -> int:
        """Return a register's value; 0 beyond the last register. Reading POWER clears the ready bit."""
        if register > CALIBRATION:
            return 0
        value = self._registers[register]
        if register == BUS:
            value |= _CONVERSION_READY * self._ready
            value |= _OVERFLOW * (self._math_overflow or self.forced_overflow)
        if register == POWER:
            self._ready = False
        return value

    def write(self, register: int, value: int) -> None:
        """Set a register. Writes to measured registers are ignored, as on the chip."""
        if register == CONFIGURATION:
            if value & _RESET_BIT:
                self.power_on()
                return
            self._registers[CONFIGURATION] = value & 0x3FFF
            self._ready = False
            self._restart()
        elif register == CALIBRATION:
            self._registers[CALIBRATION] = value & 0xFFFE  # bit 0 is a void bit, always 0
            self._compute()

    # --- the analogue side ----------------------------------------------------------------------

    def _restart(self) -> None:
        """Apply the configuration and start its first conversion."""
        configuration = self._registers[CONFIGURATION]
        mode = configuration & 0x7
        self._continuous = mode > 4
        self._sequence = [channel for channel, bit in ((SHUNT, 1), (BUS, 2)) if mode & bit]
        self._shunt_adc = converter(configuration >> 3 & 0xF)
        self._bus_adc = converter(configuration >> 7 & 0xF)
        self._shunt_limit = 4000 << (configuration >> 11 & 0x3)  # counts, 40 mV times the gain
        self._bus_limit = 8000 if configuration & 0x2000 else 4000  # counts, 32 V or 16 V
        self._begin(0, self._time)

    def _begin(self, index: int, time: float) -> None:
        self._index = index
        if index >= len(self._sequence):
            self._end = math.inf
            return
        adc = self._shunt_adc if self._sequence[index] == SHUNT else self._bus_adc
        self._end = time + adc.time
        self._sum = 0.0
        self._weight = 0.0

    def advance(self, time: float, shunt_voltage: float, bus_voltage: float) -> None:
        """Simulate from the time of the last call until a time (s), with constant pin voltages (V)."""
        start = self._time
        while self._end <= time:
            self._observe(self._end - start, shunt_voltage, bus_voltage)
            start = self._end
            self._convert(shunt_voltage, bus_voltage)
        self._observe(time - start, shunt_voltage, bus_voltage)
        self._time = time

    def _observe(self, duration: float, shunt_voltage: float, bus_voltage: float) -> None:
        if self._end != math.inf:
            voltage = shunt_voltage if self._sequence[self._index] == SHUNT else bus_voltage
            self._sum += voltage * duration
            self._weight += duration

    def _convert(self, shunt_voltage: float, bus_voltage: float) -> None:
        is_shunt = self._sequence[self._index] == SHUNT
        present = shunt_voltage if is_shunt else bus_voltage
        mean = self._sum / self._weight if self._weight > 0 else present
        if is_shunt:
            self._registers[SHUNT] = self._shunt_counts(mean) & 0xFFFF
        else:
            self._registers[BUS] = self._bus_counts(mean) << 3
        if self._index + 1 < len(self._sequence):
            self._begin(self._index + 1, self._end)
            return
        self._compute()
        self._ready = True
        self._begin(0 if self._continuous else len(self._sequence), self._end)

    def _shunt_counts(self, voltage: float) -> int:
        adc = self._shunt_adc
        noise = self._random.gauss(0.0, self._noise.shunt / math.sqrt(adc.samples))
        counts = round((voltage + noise) / _SHUNT_LSB) >> adc.lost_bits << adc.lost_bits
        return min(max(counts, -self._shunt_limit), self._shunt_limit)

    def _bus_counts(self, voltage: float) -> int:
        adc = self._bus_adc
        noise = self._random.gauss(0.0, self._noise.bus / math.sqrt(adc.samples))
        noisy = min(voltage + noise, _BUS_PIN_LIMIT)
        counts = round(noisy / _BUS_LSB) >> adc.lost_bits << adc.lost_bits
        return min(max(counts, 0), self._bus_limit)

    def _compute(self) -> None:
        """Compute Current = Shunt x Calibration / 4096 and Power = Current x Bus / 5000, in integers."""
        shunt = _signed(self._registers[SHUNT])
        product = shunt * self._registers[CALIBRATION]
        current = abs(product) // 4096 * (1 if product >= 0 else -1)
        power = abs(current) * (self._registers[BUS] >> 3) // 5000
        self._math_overflow = not -0x8000 <= current <= 0x7FFF or power > 0xFFFF
        self._registers[CURRENT] = current & 0xFFFF
        self._registers[POWER] = power & 0xFFFF


def _signed(raw: int) -> int:
    return raw - 0x10000 if raw & 0x8000 else raw


class I2cLine:
    """I2C bus that acknowledges only the chip's address."""

    def __init__(self, chip: Ina219, address: int, board: FaultBoard) -> None:
        self._chip = chip
        self._address = address
        self._board = board

    def transact(self, request: Request, time: float) -> Answer:
        """Execute a transaction at a time (s)."""
        if hang := self._board.consume(faults.I2C_TIMEOUT, time):
            return Answer(errno.ETIMEDOUT, delay=hang.value)
        if request.address != self._address or self._board.consume(faults.I2C_NACK, time):
            return Answer(errno.EREMOTEIO)
        if request.operation == frames.WRITE:
            # The chip accepts exactly two bytes per register, most significant byte first.
            if len(request.data) == 2:
                self._chip.write(request.register, int.from_bytes(request.data, "big"))
            return Answer(0)
        value = self._chip.read(request.register).to_bytes(2, "big")
        padded = value + bytes([_RELEASED]) * max(request.length - 2, 0)
        return Answer(0, padded[: request.length])
