# SPDX-License-Identifier: Apache-2.0
"""The power sensor's registers compared with the data sheet's numbers."""

from random import Random

import pytest

from worm_driver.virtual_robot.wire import ina219_chip

STEP = 0.001
READY, OVERFLOW = 2, 1


class Bench:
    """Noiseless chip at constant voltages with a clock of its own."""

    def __init__(self, shunt=0.0, bus=12.0, noise=(0.0, 0.0)):
        self.chip = ina219_chip.Ina219(*noise, Random(1))
        self.shunt, self.bus, self.steps = shunt, bus, 0

    def run(self, seconds):
        for _ in range(round(seconds / STEP)):
            self.steps += 1
            self.chip.advance(self.steps * STEP, self.shunt, self.bus)


@pytest.mark.parametrize(
    ("calibration", "shunt", "current"), [(0x1062, 0.2, 20000 * 4194 // 4096), (26842, 0.01, 6553)]
)
def test_current_and_power_are_integer_arithmetic(calibration, shunt, current):
    bench = Bench(shunt=shunt)
    bench.chip.write(ina219_chip.CALIBRATION, calibration)
    bench.run(0.01)
    assert bench.chip.read(ina219_chip.CURRENT) == current
    assert bench.chip.read(ina219_chip.BUS) == 0x5DC0 | READY  # 12 V
    assert bench.chip.read(ina219_chip.POWER) == current * 3000 // 5000


def test_a_current_backwards_is_negative_and_its_power_is_not():
    bench = Bench(shunt=-0.05)
    bench.chip.write(ina219_chip.CALIBRATION, 4096)
    bench.run(0.01)
    assert bench.chip.read(ina219_chip.CURRENT) == 0x10000 - 5000
    assert bench.chip.read(ina219_chip.POWER) == 3000


def test_ready_is_cleared_by_reading_power_only():
    bench = Bench()
    bench.run(0.01)
    for register in (ina219_chip.BUS, ina219_chip.SHUNT, ina219_chip.CURRENT, ina219_chip.BUS):
        bench.chip.read(register)
    assert bench.chip.read(ina219_chip.BUS) & READY
    bench.chip.read(ina219_chip.POWER)
    assert not bench.chip.read(ina219_chip.BUS) & READY
    bench.run(0.002)
    assert bench.chip.read(ina219_chip.BUS) & READY


def test_averaging_takes_its_time():
    bench = Bench()
    bench.chip.write(ina219_chip.CONFIGURATION, 0x1DDF)  # 8 samples per channel, 8.51 ms for both
    bench.run(0.008)
    assert not bench.chip.read(ina219_chip.BUS) & READY
    bench.run(0.001)
    assert bench.chip.read(ina219_chip.BUS) & READY


def test_overflow_is_of_the_arithmetic_not_of_the_converter():
    bench = Bench(shunt=0.5)
    bench.chip.write(ina219_chip.CALIBRATION, 4194)
    bench.run(0.01)
    # 32765 still fits: the clipped value looks valid
    assert not bench.chip.read(ina219_chip.BUS) & OVERFLOW
    bench.chip.write(ina219_chip.CALIBRATION, 4200)
    assert bench.chip.read(ina219_chip.BUS) & OVERFLOW


def test_reset_forgets_everything():
    bench, registers = Bench(shunt=0.1), [0x399F, 0, 0, 0, 0, 0]
    assert [bench.chip.read(register) for register in range(6)] == registers  # at power-up
    bench.chip.write(ina219_chip.CALIBRATION, 4096)
    bench.chip.write(ina219_chip.CONFIGURATION, 0x1DDF)
    bench.run(0.01)
    bench.chip.write(ina219_chip.CONFIGURATION, 0x8000)
    assert [bench.chip.read(register) for register in range(6)] == registers
