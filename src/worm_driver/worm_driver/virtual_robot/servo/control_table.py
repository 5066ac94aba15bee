# SPDX-License-Identifier: Apache-2.0
"""Control tables of the virtual servos, one row per register, one table per model.

The registers are written from the ROBOTIS e-manual, independently of the driver's tables, with the manual's names in
lower case. The data of the models come from `worm_msgs.servo_models`, which the driver uses, too. Indirect
addressing (168 and above) is not implemented; an access to it returns an access error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

from worm_msgs.servo_models import SERVO_MODELS, Initial, ServoRow

EEPROM_END = 64  # registers at lower addresses are locked while torque is on
TABLE_END = 168  # first address that cannot be read; the last register is at 147

CURRENT_MODE = 0
VELOCITY_MODE = 1
POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4
CURRENT_POSITION_MODE = 5  # without a limit of the current
PWM_MODE = 16

PULSES_PER_TURN = 4096  # a pulse is one count of the position registers; the driver calls it a tick
EXTENDED_RANGE = 1_048_575  # pulses, +-256 turns

PROTOCOL_2 = 2  # a servo with another protocol_type does not answer packets of Protocol 2.0

BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


@dataclass(frozen=True)
class Register:
    """One register. size: in bytes; initial: factory value, raw; low, high: lowest and highest allowed raw value."""

    name: str
    address: int
    size: int
    initial: int
    low: int = 0
    high: int = 0
    writable: bool = True

    @cached_property
    def signed(self) -> bool:
        """True if the raw value is in two's complement."""
        return self.low < 0

    def encode(self, value: int) -> bytes:
        """Return the little-endian bytes of a raw value."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes | bytearray) -> int:
        """Return the raw value of little-endian bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True)
class VirtualServoModel(ServoRow):
    """Servo model: its data, and its control table by register name."""

    registers: Mapping[str, Register] = field(default_factory=dict)


def _status(name: str, address: int, size: int, low: int = 0) -> Register:
    return Register(name, address, size, 0, low=low, writable=False)


_INT16 = -0x8000
_INT32 = -0x80000000
_MOST = 0x7FFFFFFF

_COMMON = (
    _status("model_number", 0, 2),
    _status("model_information", 2, 4),
    _status("firmware_version", 6, 1),
    Register("id", 7, 1, 1, high=252),
    Register("baud_rate", 8, 1, 1, high=7),
    Register("return_delay_time", 9, 1, 250, high=254),
    Register("drive_mode", 10, 1, 0, high=0x0D),
    Register("operating_mode", 11, 1, POSITION_MODE, high=16),
    Register("secondary_id", 12, 1, 255, high=255),
    Register("protocol_type", 13, 1, 2, low=1, high=2),
    Register("homing_offset", 20, 4, 0, low=-1_044_479, high=1_044_479),
    Register("moving_threshold", 24, 4, 10, high=1023),
    Register("temperature_limit", 31, 1, 80, high=100),
    Register("max_voltage_limit", 32, 2, 160, low=95, high=160),
    Register("min_voltage_limit", 34, 2, 95, low=95, high=160),
    Register("pwm_limit", 36, 2, 885, high=885),
    Register("velocity_limit", 44, 4, 200, high=1023),
    Register("max_position_limit", 48, 4, 4095, high=4095),
    Register("min_position_limit", 52, 4, 0, high=4095),
    Register("startup_configuration", 60, 1, 0, high=3),
    Register("shutdown", 63, 1, 52, high=0x3F),
    Register("torque_enable", 64, 1, 0, high=1),
    Register("led", 65, 1, 0, high=1),
    Register("status_return_level", 68, 1, 2, high=2),
    _status("registered_instruction", 69, 1),
    _status("hardware_error_status", 70, 1),
    Register("velocity_i_gain", 76, 2, 1920, high=16383),
    Register("velocity_p_gain", 78, 2, 100, high=16383),
    Register("position_d_gain", 80, 2, 0, high=16383),
    Register("position_i_gain", 82, 2, 0, high=16383),
    Register("position_p_gain", 84, 2, 800, high=16383),
    Register("feedforward_2nd_gain", 88, 2, 0, high=16383),
    Register("feedforward_1st_gain", 90, 2, 0, high=16383),
    Register("bus_watchdog", 98, 1, 0, low=-1, high=127),
    Register("goal_pwm", 100, 2, 885, low=-885, high=885),
    Register("goal_velocity", 104, 4, 0, low=_INT32, high=_MOST),
    Register("profile_acceleration", 108, 4, 0, high=32767),
    Register("profile_velocity", 112, 4, 0, high=32767),
    Register("goal_position", 116, 4, 0, low=_INT32, high=_MOST),
    _status("realtime_tick", 120, 2),
    _status("moving", 122, 1),
    _status("moving_status", 123, 1),
    _status("present_pwm", 124, 2, _INT16),
    _status("present_velocity", 128, 4, _INT32),
    _status("present_position", 132, 4, _INT32),
    _status("velocity_trajectory", 136, 4, _INT32),
    _status("position_trajectory", 140, 4, _INT32),
    _status("present_input_voltage", 144, 2),
    _status("present_temperature", 146, 1),
    _status("backup_ready", 147, 1),
)

# Registers to which a servo rejects writes after the Bus Watchdog has fired.
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


def _current_registers(limit: int) -> tuple[Register, ...]:
    return (
        Register("current_limit", 38, 2, limit, high=limit),
        Register("goal_current", 102, 2, limit, low=-limit, high=limit),
        _status("present_current", 126, 2, _INT16),
    )


_LOAD_REGISTERS = (_status("present_load", 126, 2, _INT16),)


def _table(extra: tuple[Register, ...], initial: Mapping[str, Initial]) -> dict[str, Register]:
    """Return the common and extra registers by name.

    Args:
        extra: registers that not every model has.
        initial: factory values of the model, or (factory value, lowest, highest), by name.
    """
    rows = {row.name: row for row in sorted(_COMMON + extra, key=lambda row: row.address)}
    for name, value in initial.items():
        if isinstance(value, int):
            rows[name] = replace(rows[name], initial=value)
        else:
            rows[name] = replace(rows[name], initial=value[0], low=value[1], high=value[2])
    return rows


def _model(row: ServoRow) -> VirtualServoModel:
    extra = _current_registers(row.current_limit) if row.measures_current else _LOAD_REGISTERS
    own = {**row.initial, "model_number": row.number, "velocity_limit": row.velocity_limit}
    return VirtualServoModel(**vars(row), registers=_table(extra, own))


MODELS: Mapping[str, VirtualServoModel] = {row.name: _model(row) for row in SERVO_MODELS}
XL330_M288, XL430_W250, XM430_W350 = (
    MODELS[name] for name in ("XL330-M288", "XL430-W250", "XM430-W350")
)
