# SPDX-License-Identifier: Apache-2.0
"""Control tables of the virtual servos: the driver's registers with their factory values and allowed values.

Sources are the ROBOTIS e-manual for the allowed values, `worm_msgs.servo_models` for the data of the models and
`servos.registers` for the registers. Indirect addressing (168 and above) is not implemented; an access to it returns an
access error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from worm_driver.servos import registers
from worm_driver.servos.registers import POSITION_MODE, Register
from worm_msgs.servo_models import SERVO_MODELS, Initial, ServoRow

EEPROM_END = 64  # registers at lower addresses are locked while torque is on
TABLE_END = 168  # first address that cannot be read; the last register is at 147

#: Operating modes that the driver does not use.
CURRENT_POSITION_MODE = 5  # without a limit of the current
PWM_MODE = 16

PULSES_PER_TURN = registers.TICKS_PER_TURN  # a pulse is one count of the position registers

PROTOCOL_2 = 2  # a servo with another protocol_type does not answer packets of Protocol 2.0

BAUD_RATES = (*registers.BAUD_RATES, 4_500_000)


@dataclass(frozen=True)
class VirtualRegister(Register):
    """Register with its factory value and the lowest and highest value that a write may contain, raw."""

    initial: int = 0
    low: int = 0
    high: int = 0

    @property
    def writable(self) -> bool:
        """False for a register that only the servo changes."""
        return self.high > self.low


@dataclass(frozen=True)
class VirtualServoModel(ServoRow):
    """Servo model: its data, and its control table by register name."""

    registers: Mapping[str, VirtualRegister] = field(default_factory=dict)


# Registers that the driver does not use.
_FURTHER = (
    Register("protocol_type", 13, 1),
    Register("moving_threshold", 24, 4),
    Register("velocity_p_gain", 78, 2),
)

_INT32 = (-0x80000000, 0x7FFFFFFF)
_GAIN = 16383

#: Initial, lowest and highest value of each register that can be written, unless the model has others.
_WRITABLE: Mapping[str, Initial] = {
    "id": (1, 0, 252),
    "baud_rate": (1, 0, 7),
    "return_delay_time": (250, 0, 254),
    "drive_mode": (0, 0, 0x0D),
    "operating_mode": (POSITION_MODE, 0, 16),
    "secondary_id": (255, 0, 255),
    "protocol_type": (PROTOCOL_2, 1, 2),
    "homing_offset": (0, -1_044_479, 1_044_479),
    "moving_threshold": (10, 0, 1023),
    "temperature_limit": (80, 0, 100),
    "max_voltage_limit": (160, 95, 160),
    "min_voltage_limit": (95, 95, 160),
    "pwm_limit": (885, 0, 885),
    "max_position_limit": (4095, 0, 4095),
    "min_position_limit": (0, 0, 4095),
    "startup_configuration": (0, 0, 3),
    "shutdown": (52, 0, 0x3F),
    "torque_enable": (0, 0, 1),
    "led": (0, 0, 1),
    "status_return_level": (2, 0, 2),
    "velocity_i_gain": (1920, 0, _GAIN),
    "velocity_p_gain": (100, 0, _GAIN),
    "position_d_gain": (0, 0, _GAIN),
    "position_i_gain": (0, 0, _GAIN),
    "position_p_gain": (800, 0, _GAIN),
    "feedforward_2nd_gain": (0, 0, _GAIN),
    "feedforward_1st_gain": (0, 0, _GAIN),
    "bus_watchdog": (0, -1, 127),
    "goal_pwm": (885, -885, 885),
    "goal_velocity": (0, *_INT32),
    "profile_acceleration": (0, 0, 32767),
    "profile_velocity": (0, 0, 32767),
    "goal_position": (0, *_INT32),
}

# Registers to which a servo rejects writes after the Bus Watchdog has fired.
GOALS = ("goal_pwm", "goal_current", "goal_velocity", "goal_position")


def _model(row: ServoRow) -> VirtualServoModel:
    limit = row.current_limit
    values = {
        **_WRITABLE,
        "current_limit": (limit, 0, limit),
        "goal_current": (limit, -limit, limit),
        "velocity_limit": row.velocity_limit,
        "model_number": row.number,
    }
    table = {}
    for each in (*registers.MODELS[row.number].registers.values(), *_FURTHER):
        usual, own = values.get(each.name, 0), row.initial.get(each.name)
        initial, low, high = (usual, 0, 0) if isinstance(usual, int) else usual
        if isinstance(own, int):
            initial = own
        elif own is not None:
            initial, low, high = own
        table[each.name] = VirtualRegister(**vars(each), initial=initial, low=low, high=high)
    return VirtualServoModel(**vars(row), registers=table)


MODELS: Mapping[str, VirtualServoModel] = {row.name: _model(row) for row in SERVO_MODELS}
XL330_M288, XL430_W250, XM430_W350 = (
    MODELS[name] for name in ("XL330-M288", "XL430-W250", "XM430-W350")
)
