# SPDX-License-Identifier: Apache-2.0
"""Conditions in the pipe: slope, tether and flow.

`worm_model.loads` adds them to the parameters of the model, and `worm_driver.virtual_robot.plant` to the motion of the
virtual robot. A force is positive towards −x, that is against a forward gait.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

from worm_msgs.input_error import InputError
from worm_msgs.robot_parameters import STANDARD_GRAVITY

WATER_DENSITY = 998.2  # kg/m³ at 20 °C


class ConditionsError(InputError):
    """A condition is not admissible. The message names it and the reason."""


def _row(option: str, unit: str, low: float, high: float, meaning: str) -> float:
    """Return a field with the default 0 and the arguments as metadata; ``option`` is its command-line option."""
    metadata = {"option": option, "unit": unit, "low": low, "high": high, "meaning": meaning}
    of_file = {"ge": low, "le": high, "description": f"{meaning}, {unit}"}  # for pydantic.Field
    return field(default=0.0, metadata={**metadata, **of_file})


@dataclass(frozen=True)
class Conditions:
    """Slope, tether and flow of a pipe. The names of the fields are also those of ROS parameters and settings.

    The tether is attached to the rear module and pulls it towards −x; a tether cannot push. ``distance_m`` is the
    length of tether in the pipe at the start.

    The water flows towards −x with ``flow_m_per_s``. ``drag_area_m2`` is C_d·A of each module. In still water,
    `drag` is not zero for a moving module. The virtual robot includes this; the model neglects it (`worm_model.loads`).

    Raises `ConditionsError` if a value is not finite or not in its range, or if it has no effect: a flow without a drag
    area, or a length of tether without a force for each metre.
    """

    slope_deg: float = _row("--slope", "deg", -90.0, 90.0, "slope of the pipe, uphill towards +x")
    tether_n: float = _row("--tether", "N", 0.0, 1e3, "pull of the tether on the rear module")
    tether_n_per_m: float = _row(
        "--tether-per-metre", "N/m", 0.0, 1e3, "further pull for each metre of tether"
    )
    distance_m: float = _row("--tether-length", "m", 0.0, 1e4, "length of tether in the pipe")
    flow_m_per_s: float = _row(
        "--flow", "m/s", -10.0, 10.0, "velocity of the water, positive towards -x"
    )
    drag_area_m2: float = _row(
        "--drag-area", "m2", 0.0, 1.0, "drag coefficient times area of each module"
    )

    def __post_init__(self) -> None:
        for name, row in CONDITION_ROWS.items():
            value, unit, low, high = getattr(self, name), row["unit"], row["low"], row["high"]
            if not low <= value <= high:
                raise ConditionsError(
                    f"{name}: {value} {unit} is not between {low:g} and {high:g} {unit}"
                )
        for given, missing in (("distance_m", "tether_n_per_m"), ("flow_m_per_s", "drag_area_m2")):
            if getattr(self, given) and not getattr(self, missing):
                raise ConditionsError(
                    f"{given}: {getattr(self, given):g} has no effect without {missing}; give both"
                )

    def __str__(self) -> str:
        """Return the values that are not zero as text, such as ``slope 20 deg, tether 2 N``, or ``level ground``."""
        text = ", ".join(
            f"{row['option'].strip('-').replace('-', ' ')} {value:g} {row['unit']}"
            for name, row in CONDITION_ROWS.items()
            if (value := getattr(self, name))
        )
        return text or "level ground"

    @cached_property
    def gravity(self) -> float:
        """Component of gravity along the pipe, m/s²."""
        return STANDARD_GRAVITY * math.sin(math.radians(self.slope_deg))

    def tether(self, travelled: float = 0.0) -> float:
        """Return the pull of the tether in N. If the robot is behind its start, return the pull at its start.

        Args:
            travelled: distance of the rear module from the start, m.
        """
        return self.tether_n + self.tether_n_per_m * (self.distance_m + max(travelled, 0.0))

    def drag(self, velocity: float = 0.0) -> float:
        """Return the drag of a module divided by its velocity relative to the water, ρ/2·C_dA·|U + x′|, in N·s/m.

        Args:
            velocity: velocity x′ of the module in the pipe, m/s.
        """
        if self.drag_area_m2 == 0.0:
            return 0.0
        return 0.5 * WATER_DENSITY * self.drag_area_m2 * abs(self.flow_m_per_s + velocity)


CONDITION_ROWS: Mapping[str, Mapping[str, Any]] = {
    row.name: row.metadata for row in fields(Conditions)
}
LEVEL = Conditions()


def conditions_of(source: Any) -> Conditions:
    """Return the conditions from the attributes of an object, such as parsed options. A missing attribute means 0."""
    return Conditions(**{name: getattr(source, name, 0.0) for name in CONDITION_ROWS})
