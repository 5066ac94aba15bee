# SPDX-License-Identifier: Apache-2.0
"""INA219 power sensor at register level.

Each step of the virtual robot sets shunt and bus voltage (V). A conversion yields the mean voltage over its duration.
The integer arithmetic is that of the data sheet SBOS448G. Whatever the configuration register contains, the chip
measures continuously with the largest ranges and 12 bit, with the same averaging of both voltages. The driver rejects
samples with another configuration than its own.
"""

import math
from random import Random

CONFIGURATION, SHUNT, BUS, POWER, CURRENT, CALIBRATION = range(6)
POWER_ON_CONFIGURATION = 0x399F

_RESET_BIT = 0x8000
CONVERSION_READY = 0x0002
_OVERFLOW = 0x0001
SHUNT_LSB = 10e-6  # V per raw unit of the shunt voltage
BUS_LSB = 4e-3  # V per raw unit of the bus voltage
_SHUNT_LIMIT = 32000  # raw shunt voltage at the ends of the range +-320 mV
_BUS_PIN_LIMIT = 26.0  # V, largest measurable bus voltage
_CONVERSION = 532e-6  # s, one 12-bit conversion without averaging


def samples_of(configuration: int) -> int:
    """Return the number of averaged samples of a conversion, which the configuration selects for the shunt (SADC)."""
    field = configuration >> 3 & 0xF
    return 1 << (field & 0x7) if field & 0x8 else 1


class Ina219:
    """INA219 chip with 16-bit raw registers. Times are in s and must not decrease.

    ``forced_overflow`` sets the overflow bit regardless of the arithmetic. ``shunt_noise`` and ``bus_noise`` are
    standard deviations of the noise of one conversion without averaging, V.
    """

    def __init__(self, shunt_noise: float, bus_noise: float, random: Random) -> None:
        self._shunt_noise, self._bus_noise = shunt_noise, bus_noise
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
            value |= CONVERSION_READY * self._ready
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
        self._samples = samples_of(self._registers[CONFIGURATION])
        self._begin(SHUNT, self._time)

    def _begin(self, channel: int, time: float) -> None:
        self._channel = channel
        self._end = time + _CONVERSION * self._samples
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
        self._sum += (shunt_voltage if self._channel == SHUNT else bus_voltage) * duration
        self._weight += duration

    def _convert(self, shunt_voltage: float, bus_voltage: float) -> None:
        present = shunt_voltage if self._channel == SHUNT else bus_voltage
        mean = self._sum / self._weight if self._weight > 0 else present
        if self._channel == SHUNT:
            counts = round((mean + self._noise_of(self._shunt_noise)) / SHUNT_LSB)
            self._registers[SHUNT] = min(max(counts, -_SHUNT_LIMIT), _SHUNT_LIMIT) & 0xFFFF
            self._begin(BUS, self._end)
        else:
            voltage = min(mean + self._noise_of(self._bus_noise), _BUS_PIN_LIMIT)
            self._registers[BUS] = max(round(voltage / BUS_LSB), 0) << 3
            self._compute()
            self._ready = True
            self._begin(SHUNT, self._end)

    def _noise_of(self, deviation: float) -> float:
        return self._random.gauss(0.0, deviation / math.sqrt(self._samples))

    def _compute(self) -> None:
        """Compute Current = Shunt x Calibration / 4096 and Power = Current x Bus / 5000, in integers."""
        shunt = signed(self._registers[SHUNT])
        product = shunt * self._registers[CALIBRATION]
        current = abs(product) // 4096 * (1 if product >= 0 else -1)
        power = abs(current) * (self._registers[BUS] >> 3) // 5000
        self._math_overflow = not -0x8000 <= current <= 0x7FFF or power > 0xFFFF
        self._registers[CURRENT] = current & 0xFFFF
        self._registers[POWER] = power & 0xFFFF


def signed(raw: int) -> int:
    """Return the value of a register in two's complement."""
    return raw - 0x10000 if raw & 0x8000 else raw
