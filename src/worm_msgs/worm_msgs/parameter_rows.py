# SPDX-License-Identifier: Apache-2.0
"""Descriptions of the parameters of nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rcl_interfaces.msg import ParameterDescriptor


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
