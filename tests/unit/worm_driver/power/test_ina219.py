# SPDX-License-Identifier: Apache-2.0
"""The power sensor's driver against a chip at register level."""

import errno
import math

import pytest
from driver_rig import Clock, DirectSMBus

from worm_driver.driver_errors import ConfigurationError, PowerSensorError
from worm_driver.power.i2c import I2CDevice, open_device, swap
from worm_driver.power.ina219 import (
    FROZEN,
    INA219,
    POWER_ON_CONFIGURATION,
    RUNNING_CONFIGURATION,
    SampleStatus,
    calibration_for,
)
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_driver.virtual_robot.wire.faults import make_fault


class Chip:
    """The virtual robot's sensor behind the driver, on a clock of its own."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.robot = VirtualRobot(load_settings(None))
        bus = DirectSMBus(self.robot, self.clock)
        self.sensor = INA219(I2CDevice(bus, "1", 0x40), 0.1, calibration_for(0.1, 3.2))

    def sample(self, after: float = 0.01):
        self.clock.now += after
        return self.sensor.sample(self.clock.now)

    def inject(self, name: str, **arguments: object) -> None:
        self.robot.board.add(make_fault(name, **arguments).delayed(self.clock.now))


@pytest.fixture
def chip() -> Chip:
    chip = Chip()
    chip.sensor.start()
    chip.sample(0.02)
    return chip


class RegisterBus:
    """Bus whose registers are sent as 16-bit values, high byte first."""

    def __init__(self, registers) -> None:
        self.registers = registers

    def read_word_data(self, i2c_addr, register):
        return swap(self.registers.get(register, 0))

    def write_word_data(self, i2c_addr, register, value):
        return None

    def close(self):
        return None


def test_the_bytes_of_smbus_values_are_swapped():
    """Unswapped, 12.000 V (0x5DC2) would read a plausible 24.876 V."""
    device = I2CDevice(RegisterBus({2: 0x5DC2}), "1", 0x40)
    assert (device.read(2) >> 3) * 4e-3 == pytest.approx(12.0, abs=1e-9)
    assert (swap(0x5DC2) >> 3) * 4e-3 == pytest.approx(24.876, abs=0.01)


def test_a_sample_is_the_supplys_voltage_and_current(chip):
    sample = chip.sample()
    assert sample.status is SampleStatus.VALID
    assert sample.bus_voltage == pytest.approx(12.0, abs=0.1)
    assert sample.power == pytest.approx(0.84, abs=0.15)
    assert sample.time == chip.clock.now


@pytest.mark.parametrize("before", [POWER_ON_CONFIGURATION, RUNNING_CONFIGURATION, 0x1234])
def test_an_adapter_that_swaps_bytes_is_noticed_whatever_the_chip_was_set_to(before):
    """The value of the reset is swapped, too, and has no effect."""

    class Swapping(DirectSMBus):
        def read_word_data(self, i2c_addr, register):
            return swap(super().read_word_data(i2c_addr, register))

        def write_word_data(self, i2c_addr, register, value):
            super().write_word_data(i2c_addr, register, swap(value))

    chip = Chip()
    chip.robot.chip.write(0, before)
    chip.sensor.device.bus = Swapping(chip.robot, chip.clock)
    with pytest.raises(PowerSensorError, match="swaps bytes"):
        chip.sensor.start()


@pytest.mark.parametrize(
    ("content", "expected"),
    [(0x1234, "0x40 on I2C bus 1 is no INA219, .* 0x1234"), (0x399F, "loses its settings")],
)
def test_another_chip_or_settings_that_do_not_stick_are_noticed_at_the_start(content, expected):
    with pytest.raises(PowerSensorError, match=expected):
        INA219(I2CDevice(RegisterBus({0: content}), "1", 0x40), 0.1, 4194).start()


def test_looking_too_often_gives_not_ready_and_no_old_value(chip):
    assert chip.sample(0.010).status is SampleStatus.VALID
    again = chip.sample(0.001)
    assert again.status is SampleStatus.NOT_READY
    assert math.isnan(again.power)
    assert chip.sample(0.010).status is SampleStatus.VALID


@pytest.mark.parametrize("fault", ["ina219_overflow", "ina219_saturation"])
def test_an_overflow_is_no_number(chip, fault):
    chip.inject(fault, duration=0.2)
    chip.sample(0.02)
    seen = [chip.sample() for _ in range(10)]
    assert {sample.status for sample in seen} == {SampleStatus.OVERFLOW}
    assert all(math.isnan(sample.power) for sample in seen)
    chip.sample(0.2)
    assert chip.sample().status is SampleStatus.VALID


def test_the_chips_overflow_bit_counts_even_where_the_shunt_is_in_range():
    """The current register overflows first if max_current_a is small."""
    registers = {0: RUNNING_CONFIGURATION, 1: 20_000, 2: 3000 << 3 | 0b11, 5: 4194}
    sensor = INA219(I2CDevice(RegisterBus(registers), "1", 0x40), 0.1, 4194)
    assert sensor.sample(1.0).status is SampleStatus.OVERFLOW
    registers[2] = 3000 << 3 | 0b10
    assert sensor.sample(1.0).current == pytest.approx(2.0)


def test_a_brown_out_is_noticed_with_the_next_sample_and_repaired(chip):
    """Without a check of the calibration, a chip that lost it reads as if nothing had happened."""
    chip.inject("ina219_reset")
    seen = [chip.sample().status for _ in range(6)]
    assert seen.count(SampleStatus.SENSOR_RESET) == 1
    assert SampleStatus.OVERFLOW not in seen
    assert seen[-1] is SampleStatus.VALID
    assert chip.sensor.is_set_up()
    chip.robot.chip.power_on()  # no valid sample lies between it and its discovery
    assert chip.sample().status is SampleStatus.SENSOR_RESET


@pytest.mark.parametrize(
    "configuration",
    [
        RUNNING_CONFIGURATION & ~0x1800,  # range 40 mV: 4.8 W instead of 13.4 W
        RUNNING_CONFIGURATION & ~0x2000,  # range 16 V
        RUNNING_CONFIGURATION & ~0x0007,  # power-down
        RUNNING_CONFIGURATION & ~0x0078,  # 9 bit
    ],
)
def test_a_stray_write_to_the_configuration_yields_no_number_and_is_repaired(chip, configuration):
    usual = chip.sample().power
    chip.robot.chip.write(0, configuration)
    seen = [chip.sample() for _ in range(6)]
    assert seen[0].status is SampleStatus.SENSOR_RESET
    assert math.isnan(seen[0].power)
    assert seen[-1].status is SampleStatus.VALID
    assert all(s.power == pytest.approx(usual, rel=0.2) for s in seen if not math.isnan(s.power))
    assert chip.sensor.is_set_up()


@pytest.mark.parametrize("fault", ["i2c_nack", "i2c_timeout"])
def test_a_bus_error_is_a_sample_without_a_value(chip, fault):
    chip.inject(fault, count=1)
    sample = chip.sample()
    assert sample.status is SampleStatus.BUS_ERROR
    assert math.isnan(sample.power)
    assert chip.sample().status is SampleStatus.VALID


@pytest.mark.parametrize(("resistance", "current", "value"), [(0.1, 3.2, 4194), (0.01, 5.0, 26842)])
def test_the_calibration_is_the_data_sheets(resistance, current, value):
    assert calibration_for(resistance, current) == value
    assert all(calibration_for(mohm * 1e-3, 3.0) & 1 == 0 for mohm in range(10, 100))


@pytest.mark.parametrize(
    ("resistance", "current", "least"),
    [
        (0.1, 0.2, r"0\.205"),
        (0.1, 0.1, r"0\.205"),
        (0.01, 2.0, r"2\.05"),
        (10.0, 1e-3, r"0\.00205"),
        (1e-200, 1e-200, r"2\.05e\+198"),
    ],
)
def test_a_current_too_small_for_the_register_is_rejected_and_the_smallest_one_is_usable(
    resistance, current, least
):
    with pytest.raises(ConfigurationError, match=rf"max_current_a .* at least {least} A"):
        calibration_for(resistance, current)
    assert 0 < calibration_for(resistance, float(least.replace("\\", ""))) <= 0xFFFE


@pytest.mark.parametrize(
    ("resistance", "current", "expected"),
    [
        *((0.0, 3.2, None), (-0.1, 3.2, None), (0.1, 0.0, None), (0.1, math.nan, None)),
        (0.1, 5.0, r"at most 3\.2 A, or a smaller shunt"),
    ],
)
def test_an_impossible_shunt_or_range_is_rejected(resistance, current, expected):
    with pytest.raises(ConfigurationError, match=expected):
        calibration_for(resistance, current)


def test_a_missing_bus_is_named_with_the_remedy(tmp_path):
    with pytest.raises(PowerSensorError, match=r"does not exist: enable I2C"):
        open_device(str(tmp_path / "i2c-9"), 0x40)
    with pytest.raises(PowerSensorError, match=r"bus 99 does not exist"):
        open_device("99", 0x40)
    (tmp_path / "i2c").touch()
    with pytest.raises(PowerSensorError, match="cannot be opened"):
        open_device(str(tmp_path / "i2c"), 0x40)


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        (errno.EREMOTEIO, "does not acknowledge"),
        (errno.ETIMEDOUT, "block"),
        (errno.EBUSY, "ina2xx"),
        (errno.EIO, "failed"),
    ],
)
def test_each_failure_of_the_bus_has_its_message(number, expected):
    class Broken(RegisterBus):
        def read_word_data(self, i2c_addr, register):
            raise OSError(number, "broken")

    with pytest.raises(PowerSensorError, match=expected):
        I2CDevice(Broken({}), "1", 0x40).read(0)


def test_a_sensor_that_repeats_the_same_bits_is_not_valid_and_one_that_repeats_a_few_is():
    registers = {0: RUNNING_CONFIGURATION, 1: 2_000, 2: 3000 << 3 | 0b10, 3: 0, 5: 4194}
    sensor = INA219(I2CDevice(RegisterBus(registers), "1", 0x40), 0.1, 4194)
    seen = [sensor.sample(i * 0.01).status for i in range(465)]
    assert seen[: FROZEN - 1] == [SampleStatus.VALID] * (FROZEN - 1)
    assert set(seen[FROZEN:]) == {SampleStatus.NOT_READY}
    registers[1] += 1
    assert sensor.sample(5.0).status is SampleStatus.VALID
