# SPDX-License-Identifier: Apache-2.0
"""Data of the servo models in one table, with one row per model.

The driver's control tables, the virtual robot's servos and the optimizer's limits on gaits are built from these rows.
Source: ROBOTIS e-manual, sections Specifications and Control Table of each model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

RPM = 2.0 * math.pi / 60.0  # 1 rpm in rad/s
VELOCITY_UNIT = 0.229  # rpm per unit of the velocity registers, as rounded in the manual

#: Initial value of a register, or (initial value, lowest, highest), raw.
Initial = int | tuple[int, int, int]


@dataclass(frozen=True)
class ServoRow:
    """Data of a servo model.

    The no-load speed, the stall torque and the stall current hold at the nominal voltage and are proportional to the
    voltage.

    Attributes:
        name: name of the model without the connector's suffix (-T, -R).
        number: model number that a ping returns.
        minimum_firmware: first version with a bus watchdog.
        modes: supported values of the register operating_mode.
        supply_range: smallest and largest supply voltage, V.
        nominal_voltage: supply voltage that the manual recommends, V.
        no_load_speed: speed without load, rpm.
        stall_torque: momentary torque at standstill, N·m.
        stall_current: current at standstill, A.
        velocity_limit: initial value and range of the register velocity_limit, raw.
        current_unit: current per unit of the current registers, A; 0: the model reports a load instead.
        current_limit: largest value of the register current_limit, raw; 0 without this register.
        initial: further registers in which the models differ, by register name: the initial value, or (initial value,
            lowest, highest), raw.
    """

    name: str
    number: int
    minimum_firmware: int
    modes: frozenset[int]
    supply_range: tuple[float, float]
    nominal_voltage: float
    no_load_speed: float
    stall_torque: float
    stall_current: float
    velocity_limit: Initial
    current_unit: float = 0.0
    current_limit: int = 0
    initial: Mapping[str, Initial] = field(default_factory=dict)

    @property
    def measures_current(self) -> bool:
        """False for a model that reports an estimated load ratio instead of a current."""
        return self.current_unit > 0.0

    @property
    def torque_constant(self) -> float:
        """Stall torque divided by stall current, N·m/A; NaN for a model that measures no current."""
        return self.stall_torque / self.stall_current if self.measures_current else math.nan


SERVO_MODELS: tuple[ServoRow, ...] = (
    ServoRow(
        name="XL330-M288",
        number=1200,
        minimum_firmware=38,
        modes=frozenset({0, 1, 3, 4, 5, 16}),
        supply_range=(3.7, 6.0),
        nominal_voltage=5.0,
        no_load_speed=103.0,
        stall_torque=0.52,
        stall_current=1.47,
        velocity_limit=(445, 0, 2047),
        current_unit=1e-3,
        current_limit=1750,
        initial={
            "firmware_version": 52,
            "baud_rate": (1, 0, 6),
            "temperature_limit": 70,
            "max_voltage_limit": (70, 31, 70),
            "min_voltage_limit": (35, 31, 70),
            "shutdown": 53,
            "velocity_i_gain": 1600,
            "velocity_p_gain": 180,
            "position_p_gain": 400,
        },
    ),
    ServoRow(
        name="XL430-W250",
        number=1060,
        minimum_firmware=38,
        modes=frozenset({1, 3, 4, 16}),
        supply_range=(6.0, 14.0),
        nominal_voltage=12.0,
        no_load_speed=61.0,
        stall_torque=1.5,
        stall_current=1.4,
        velocity_limit=(265, 0, 1023),
        initial={
            "firmware_version": 47,
            "temperature_limit": 72,
            "max_voltage_limit": (140, 60, 140),
            "min_voltage_limit": (60, 60, 140),
            "velocity_i_gain": 1000,
            "position_d_gain": 4000,
            "position_p_gain": 640,
        },
    ),
    ServoRow(
        name="XM430-W350",
        number=1020,
        minimum_firmware=38,
        modes=frozenset({0, 1, 3, 4, 5, 16}),
        supply_range=(9.5, 16.0),
        nominal_voltage=12.0,
        no_load_speed=46.0,
        stall_torque=4.1,
        stall_current=2.3,
        velocity_limit=(200, 0, 1023),
        current_unit=2.69e-3,
        current_limit=1193,
        initial={"firmware_version": 48},
    ),
)
