# SPDX-License-Identifier: Apache-2.0
"""Descriptions of the parameters of nodes, and the former names that are still accepted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor

T = TypeVar("T")

#: Present names of renamed parameters, by former name. A former name is accepted with a warning; the next version
#: rejects it.
RENAMED: Mapping[str, str] = {
    "rate_Hz": "rate_hz",
    "ina219.max_current_A": "ina219.max_current_a",
    "fin_servos.speed_rad_s": "fin_servos.speed_rad_per_s",
    "limits.max_frequency_Hz": "limits.max_frequency_hz",
    "limits.max_cable_speed_m_s": "limits.max_cable_speed_m_per_s",
    "limits.max_servo_current_A": "limits.max_servo_current_a",
    "return_speed_m_s": "return_speed_m_per_s",
    "power_scale_W": "power_scale_w",
}


@dataclass(frozen=True)
class ParameterRow:
    """One parameter of a node.

    Attributes:
        name: lower snake case, with the unit as its last part.
        default: default value, of the type of the parameter.
        description: for --help and ``ros2 param describe``.
        low: lower limit of a number; None without limits.
        high: upper limit, given together with ``low``.
        read_only: True if the parameter can only be set at the start of the node.
    """

    name: str
    default: Any
    description: str
    low: float | None = None
    high: float | None = None
    read_only: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """Return the descriptor of the parameter.

        Each call returns a new object, because rclpy modifies the descriptor when it declares the parameter.
        """
        from rcl_interfaces.msg import (  # The optimizer imports this module without ROS.
            FloatingPointRange,
            IntegerRange,
            ParameterDescriptor,
        )

        made = ParameterDescriptor(
            name=self.name, description=self.description, read_only=self.read_only
        )
        if self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                whole = IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
                made.integer_range = [whole]
            else:
                real = FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
                made.floating_point_range = [real]
        return made


def present_names(values: Mapping[str, T], warn: Callable[[str], None]) -> dict[str, T]:
    """Return values by the present names of their parameters. Call ``warn`` with a message for each former name.

    Raises:
        ValueError: A parameter is given by its former and by its present name.
    """
    result = {name: value for name, value in values.items() if name not in RENAMED}
    for former, name in RENAMED.items():
        if former not in values:
            continue
        if name in result:
            raise ValueError(
                f"parameter {name} is also given by its former name {former}: remove {former}"
            )
        warn(
            f"parameter {former} is now named {name}: rename it, because the next version rejects {former}"
        )
        result[name] = values[former]
    return result
