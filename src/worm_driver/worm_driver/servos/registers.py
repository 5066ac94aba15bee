# SPDX-License-Identifier: Apache-2.0
"""Control tables of the Dynamixel X series, as data.

Each register is a row, and each servo model has a table of rows. Registers have the names of the e-manual, in lower
case. Sources are the ROBOTIS e-manual (control table of each model) and the ``.model`` files of DynamixelSDK. In these
files the velocity unit is 0.0239691227 rad/s. The manual rounds it to 0.229 rpm.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

from worm_msgs.servo_models import SERVO_MODELS, ServoRow

TICKS_PER_TURN = 4096
#: Largest id of a servo (Protocol 2.0).
HIGHEST_ID = 252
#: Baud rates (bit/s) by the raw value of the register baud_rate (e-manual), without 4.5 Mbit/s, which the SDK lacks.
BAUD_RATES = (9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
#: Largest absolute value of a goal in extended position mode, ticks (e-manual, operating mode 4).
EXTENDED_POSITION_LIMIT = 1_048_575

VELOCITY_MODE = 1
POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4

#: Value of bus_watchdog once it has expired (e-manual, bus watchdog: -1).
WATCHDOG_EXPIRED = -1

#: Fault that each bit of hardware_error_status reports.
HARDWARE_ERRORS: Mapping[int, str] = MappingProxyType(
    {
        0: "input voltage",
        2: "overheating",
        3: "encoder",
        4: "electrical shock",
        5: "overload",
    }
)


@dataclass(frozen=True)
class Register:
    """Row of a control table: ``value = raw * scale`` in ``unit``. The size is in bytes.

    In the package ``servos``, only this class converts between the bytes of a register, little-endian and in two's
    complement if signed, its raw integer, and its value.
    """

    name: str
    address: int
    size: int
    signed: bool = False
    scale: float = 1.0
    unit: str = "1"

    @property
    def end(self) -> int:
        """Address of the byte after the register's last byte."""
        return self.address + self.size

    def pack(self, raw: int) -> bytes:
        """Return the bytes of a raw value. Raises ValueError if it does not fit the register."""
        try:
            return raw.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{raw} does not fit {self.name} ({self.size} bytes)") from None

    def unpack(self, data: bytes) -> int:
        """Return the raw value of bytes, with its sign. Raises ValueError if their number is not the size."""
        if len(data) != self.size:
            raise ValueError(f"{self.name} has {self.size} bytes, not {len(data)}")
        return int.from_bytes(data, "little", signed=self.signed)

    def unpack_from(self, block: bytes, start: int) -> int:
        """Return the raw value in a block that begins at address ``start``. Raises ValueError if it is outside."""
        offset = self.address - start
        if offset < 0:
            raise ValueError(f"{self.name} begins before the block")
        return self.unpack(block[offset : self.end - start])

    def to_raw(self, value: float) -> int:
        """Return the raw value nearest to a value. Raises ValueError if it is not finite, or does not fit."""
        if not math.isfinite(value):
            raise ValueError(f"{self.name} cannot be {value}")
        raw = round(value / self.scale)
        self.pack(raw)
        return raw

    def from_raw(self, raw: int) -> float:
        """Return the value of a raw value."""
        return raw * self.scale


@dataclass(frozen=True)
class ServoModel(ServoRow):
    """Servo model: its data, and its control table by register name."""

    registers: Mapping[str, Register] = field(default_factory=dict, repr=False)

    @cached_property
    def factory(self) -> Mapping[str, int]:
        """Factory values of registers in which the models differ, raw, by register name."""
        given = {**self.initial, "velocity_limit": self.velocity_limit}
        return {name: raw if isinstance(raw, int) else raw[0] for name, raw in given.items()}

    @property
    def strongest_current(self) -> float:
        """Largest value that current_limit accepts, A."""
        return self.current_limit * self.current_unit

    def __getitem__(self, name: str) -> Register:
        return self.registers[name]


# Scales of the registers: value of one raw unit, in rad, rad/s, rad/s^2 and 1.
_RAD = 2 * math.pi / TICKS_PER_TURN
_RAD_S = 0.0239691227
_RAD_S2 = 214.577 * 2 * math.pi / 3600  # 214.577 turns per minute squared
_PWM = 0.00113  # share of the full output

_COMMON = (
    Register("model_number", 0, 2),
    Register("firmware_version", 6, 1),
    Register("id", 7, 1),
    Register("baud_rate", 8, 1),
    Register("return_delay_time", 9, 1, scale=2e-6, unit="s"),
    Register("drive_mode", 10, 1),
    Register("operating_mode", 11, 1),
    Register("secondary_id", 12, 1),
    Register("homing_offset", 20, 4, True, _RAD, "rad"),
    Register("temperature_limit", 31, 1, unit="degC"),
    Register("max_voltage_limit", 32, 2, scale=0.1, unit="V"),
    Register("min_voltage_limit", 34, 2, scale=0.1, unit="V"),
    Register("pwm_limit", 36, 2, scale=_PWM),
    Register("velocity_limit", 44, 4, scale=_RAD_S, unit="rad/s"),
    Register("max_position_limit", 48, 4, scale=_RAD, unit="rad"),
    Register("min_position_limit", 52, 4, scale=_RAD, unit="rad"),
    Register("startup_configuration", 60, 1),
    Register("shutdown", 63, 1),
    Register("torque_enable", 64, 1),
    Register("led", 65, 1),
    Register("status_return_level", 68, 1),
    Register("hardware_error_status", 70, 1),
    Register("velocity_i_gain", 76, 2),
    Register("position_d_gain", 80, 2),
    Register("position_i_gain", 82, 2),
    Register("position_p_gain", 84, 2),
    Register("feedforward_2nd_gain", 88, 2),
    Register("feedforward_1st_gain", 90, 2),
    Register("bus_watchdog", 98, 1, True, 0.02, "s"),
    Register("goal_pwm", 100, 2, True, _PWM),
    Register("goal_velocity", 104, 4, True, _RAD_S, "rad/s"),
    Register("profile_acceleration", 108, 4, scale=_RAD_S2, unit="rad/s2"),
    Register("profile_velocity", 112, 4, scale=_RAD_S, unit="rad/s"),
    Register("goal_position", 116, 4, True, _RAD, "rad"),
    Register("realtime_tick", 120, 2, scale=1e-3, unit="s"),
    Register("moving", 122, 1),
    Register("moving_status", 123, 1),
    Register("present_pwm", 124, 2, True, _PWM),
    Register("present_velocity", 128, 4, True, _RAD_S, "rad/s"),
    Register("present_position", 132, 4, True, _RAD, "rad"),
    Register("velocity_trajectory", 136, 4, True, _RAD_S, "rad/s"),
    Register("position_trajectory", 140, 4, True, _RAD, "rad"),
    Register("present_input_voltage", 144, 2, scale=0.1, unit="V"),
    Register("present_temperature", 146, 1, unit="degC"),
)


def _current(scale: float) -> tuple[Register, ...]:
    return (
        Register("current_limit", 38, 2, scale=scale, unit="A"),
        Register("goal_current", 102, 2, True, scale, "A"),
        Register("present_current", 126, 2, True, scale, "A"),
    )


_LOAD = (Register("present_load", 126, 2, True, 1e-3),)


def _table(*own: Register) -> Mapping[str, Register]:
    return MappingProxyType({row.name: row for row in (*_COMMON, *own)})


def _model(row: ServoRow) -> ServoModel:
    table = _table(*(_current(row.current_unit) if row.measures_current else _LOAD))
    return ServoModel(**{**vars(row), "name": f"{row.name}-T"}, registers=table)


MODELS: Mapping[int, ServoModel] = MappingProxyType(
    {row.number: _model(row) for row in SERVO_MODELS}
)
XL330_M288, XL430_W250, XM430_W350 = (MODELS[number] for number in (1200, 1060, 1020))

#: Registers that have the same address in every model, for exchanges with several models at once.
COMMON: Mapping[str, Register] = _table()


def hardware_error_text(status: int) -> str:
    """Return the names of the faults in a hardware_error_status byte."""
    names = [name for bit, name in HARDWARE_ERRORS.items() if status >> bit & 1]
    return ", ".join(names) if names else f"unknown fault 0x{status:02X}"
