# SPDX-License-Identifier: Apache-2.0
"""Control tables of the virtual servos, one row per register, one table per model.

Written from the ROBOTIS e-manual, apart from the driver's tables. Names are the manual's in lower
case. Left out: indirect addressing (168 and above), which answers with an access error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

EEPROM_END = 64  # addresses below are locked while torque is on
TABLE_END = 168

CURRENT_MODE = 0
VELOCITY_MODE = 1
POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4
CURRENT_POSITION_MODE = 5
PWM_MODE = 16

PULSES_PER_TURN = 4096
EXTENDED_RANGE = 1_048_575  # pulses, +-256 turns

BAUD_RATES = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


@dataclass(frozen=True)
class Register:
    """One row: initial is the factory value; low and high bound what may be written, raw."""

    name: str
    address: int
    size: int
    initial: int
    low: int = 0
    high: int = 0
    writable: bool = True

    @property
    def signed(self) -> bool:
        """Whether the raw value is two's complement."""
        return self.low < 0

    def encode(self, value: int) -> bytes:
        """Little-endian bytes of a raw value."""
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes | bytearray) -> int:
        """The raw value of little-endian bytes."""
        return int.from_bytes(data, "little", signed=self.signed)


@dataclass(frozen=True)
class ServoModel:
    """A servo model: its table and what its motor can do.

    modes: values that Operating Mode takes. current_unit (A): scale of the current registers, 0 for
    a model that reports load instead. supply_range: V. no_load_speed (rad/s) at nominal_voltage
    (V), stall_torque (N*m) at stall_current (A), from the data sheets.
    """

    name: str
    number: int
    modes: frozenset[int]
    registers: Mapping[str, Register]
    current_unit: float
    supply_range: tuple[float, float]
    nominal_voltage: float
    no_load_speed: float
    stall_torque: float
    stall_current: float

    @property
    def torque_constant(self) -> float:
        """N*m/A, stall torque over stall current."""
        return self.stall_torque / self.stall_current


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
    Register("protocol_type", 13, 1, 2, low=2, high=2),
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

# Goals that a servo in the Bus Watchdog's error state does not take.
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


def _current_registers(limit: int) -> tuple[Register, ...]:
    return (
        Register("current_limit", 38, 2, limit, high=limit),
        Register("goal_current", 102, 2, limit, low=-limit, high=limit),
        _status("present_current", 126, 2, _INT16),
    )


_LOAD_REGISTERS = (_status("present_load", 126, 2, _INT16),)


def _table(
    extra: tuple[Register, ...], **initial: int | tuple[int, int, int]
) -> dict[str, Register]:
    """The common rows with others added; initial: factory value, or (factory value, low, high)."""
    rows = {row.name: row for row in sorted(_COMMON + extra, key=lambda row: row.address)}
    for name, value in initial.items():
        if isinstance(value, int):
            rows[name] = replace(rows[name], initial=value)
        else:
            rows[name] = replace(rows[name], initial=value[0], low=value[1], high=value[2])
    return rows


XL330_M288 = ServoModel(
    name="XL330-M288",
    number=1200,
    modes=frozenset({0, 1, 3, 4, 5, 16}),
    registers=_table(
        _current_registers(1750),
        model_number=1200,
        firmware_version=52,
        baud_rate=(1, 0, 6),
        temperature_limit=70,
        max_voltage_limit=(70, 31, 70),
        min_voltage_limit=(35, 31, 70),
        velocity_limit=(445, 0, 2047),
        shutdown=53,
        velocity_i_gain=1600,
        velocity_p_gain=180,
        position_p_gain=400,
    ),
    current_unit=1e-3,
    supply_range=(3.7, 6.0),
    nominal_voltage=5.0,
    no_load_speed=10.8,
    stall_torque=0.52,
    stall_current=1.47,
)

XL430_W250 = ServoModel(
    name="XL430-W250",
    number=1060,
    modes=frozenset({1, 3, 4, 16}),
    registers=_table(
        _LOAD_REGISTERS,
        model_number=1060,
        firmware_version=47,
        temperature_limit=72,
        max_voltage_limit=(140, 60, 140),
        min_voltage_limit=(60, 60, 140),
        velocity_limit=(265, 0, 1023),
        velocity_i_gain=1000,
        position_d_gain=4000,
        position_p_gain=640,
    ),
    current_unit=0.0,
    supply_range=(6.0, 14.0),
    nominal_voltage=12.0,
    no_load_speed=6.39,
    stall_torque=1.5,
    stall_current=1.4,
)

XM430_W350 = ServoModel(
    name="XM430-W350",
    number=1020,
    modes=frozenset({0, 1, 3, 4, 5, 16}),
    registers=_table(_current_registers(1193), model_number=1020, firmware_version=48),
    current_unit=2.69e-3,
    supply_range=(9.5, 16.0),
    nominal_voltage=12.0,
    no_load_speed=4.82,
    stall_torque=4.1,
    stall_current=2.3,
)

MODELS: Mapping[str, ServoModel] = {
    model.name: model for model in (XL330_M288, XL430_W250, XM430_W350)
}
