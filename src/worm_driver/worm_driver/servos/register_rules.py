# SPDX-License-Identifier: Apache-2.0
"""What the driver does with each register that another program may have changed: one row per writable register.

The driver writes the register, or checks it and rejects an unsuitable value, or the value cannot affect the driver. The
functions that do this are in `servo_setup`. Registers that no program can write are not listed. Indirect addresses
(168 and above) are not listed either, because the driver does not access them.
"""

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from worm_driver.servos.registers import ServoModel


class Treatment(enum.Enum):
    """What the driver does with a register."""

    WRITTEN = "written to the EEPROM at configure, while the torque is off"
    RESET = "written to the RAM at configure or activate"
    CHECKED = "checked at configure"
    IRRELEVANT = "not accessed"


@dataclass(frozen=True)
class Rule:
    """Treatment of a register.

    Attributes:
        treatment: what the driver does.
        why: why the driver needs this, or why the value cannot affect it.
        value: the required raw value, unless `ServoModel.factory` contains another one for the model; None if it
            depends on the settings.
    """

    treatment: Treatment
    why: str
    value: int | None = None


_FULL_PWM = "a lower value makes the servo slow and weak"
_POSITION_CONTROL = "position control of the servo"
_FIN_ANGLE = "the angles of a fin must lie within the limits; a cable servo's mode ignores them"
_BY_PING = "a servo with another value answers no ping"
_OTHER_MODES = "only effective in other operating modes"

RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "id": Rule(Treatment.CHECKED, _BY_PING),
        "baud_rate": Rule(Treatment.CHECKED, _BY_PING),
        "return_delay_time": Rule(Treatment.WRITTEN, "delay of each answer", 0),
        "drive_mode": Rule(Treatment.WRITTEN, "direction, and kind of profile", 0),
        "operating_mode": Rule(
            Treatment.WRITTEN, "extended position for a cable, position for a fin"
        ),
        "secondary_id": Rule(
            Treatment.CHECKED, "the servo would also obey commands for the servo with this id", 255
        ),
        "protocol_type": Rule(Treatment.CHECKED, _BY_PING),
        "homing_offset": Rule(
            Treatment.CHECKED,
            "part of a cable's home mark; a fin's angles count from its encoder's 0",
        ),
        "moving_threshold": Rule(Treatment.IRRELEVANT, "threshold of the register moving"),
        "temperature_limit": Rule(
            Treatment.CHECKED, "the servo protects itself at the factory value", 80
        ),
        "max_voltage_limit": Rule(Treatment.CHECKED, "the supply must lie within both limits"),
        "min_voltage_limit": Rule(Treatment.CHECKED, "the supply must lie within both limits"),
        "pwm_limit": Rule(Treatment.CHECKED, _FULL_PWM, 885),
        "current_limit": Rule(
            Treatment.WRITTEN, "limit of the cable's force; the maximum for a fin"
        ),
        "velocity_limit": Rule(Treatment.CHECKED, "the servo must reach the speed of the settings"),
        "max_position_limit": Rule(Treatment.CHECKED, _FIN_ANGLE),
        "min_position_limit": Rule(Treatment.CHECKED, _FIN_ANGLE),
        "startup_configuration": Rule(Treatment.WRITTEN, "a restarted servo has no torque", 0),
        "shutdown": Rule(Treatment.CHECKED, "the servo protects itself at the factory value", 52),
        "torque_enable": Rule(Treatment.RESET, "off, unless it holds a contracted robot"),
        "led": Rule(Treatment.RESET, "part of a cable's home mark"),
        "status_return_level": Rule(Treatment.RESET, "the servo must answer all requests", 2),
        "velocity_i_gain": Rule(Treatment.RESET, "part of a cable's home mark"),
        "velocity_p_gain": Rule(Treatment.IRRELEVANT, _OTHER_MODES),
        "position_d_gain": Rule(Treatment.RESET, _POSITION_CONTROL, 0),
        "position_i_gain": Rule(Treatment.RESET, _POSITION_CONTROL, 0),
        "position_p_gain": Rule(Treatment.RESET, _POSITION_CONTROL, 800),
        "feedforward_2nd_gain": Rule(Treatment.RESET, _POSITION_CONTROL, 0),
        "feedforward_1st_gain": Rule(Treatment.RESET, _POSITION_CONTROL, 0),
        "bus_watchdog": Rule(Treatment.RESET, "stops the servo without a driver"),
        "goal_pwm": Rule(Treatment.RESET, "limit of the output"),
        "goal_current": Rule(Treatment.IRRELEVANT, _OTHER_MODES),
        "goal_velocity": Rule(Treatment.IRRELEVANT, _OTHER_MODES),
        "profile_acceleration": Rule(Treatment.RESET, "0: the servo does not delay a goal", 0),
        "profile_velocity": Rule(Treatment.RESET, "limit of the speed"),
        "goal_position": Rule(Treatment.RESET, "the present position when the torque goes on"),
    }
)


def required(model: ServoModel, treatment: Treatment) -> dict[str, int]:
    """Return the raw values, by name, of a model's registers with a treatment and a value that no setting changes."""
    return {
        name: model.factory.get(name, rule.value)
        for name, rule in RULES.items()
        if rule.treatment is treatment and rule.value is not None
    }
