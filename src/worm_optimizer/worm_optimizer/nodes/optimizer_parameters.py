# SPDX-License-Identifier: Apache-2.0
"""ROS parameters of the optimizer node: those of `search_settings.SETTINGS` and the parameter file."""

from __future__ import annotations

import dataclasses

from rclpy.node import Node

from worm_model.conditions import CONDITION_PARAMETERS
from worm_msgs.parameter_rows import ParameterRow
from worm_optimizer.search.search_settings import SETTINGS, Settings, settings_of

PARAMETER_FILE = "parameter_file"
MOST_RESTING = 8  # largest number of stored fronts for other initial lengths


def rows() -> list[ParameterRow]:
    """Return the declarations of all parameters. Parameter file and conditions can change while the node runs."""
    settings = (
        ParameterRow(row.parameter, row.default, row.meaning, row.low, row.high) for row in SETTINGS
    )
    return [
        ParameterRow(PARAMETER_FILE, "", "Parameter file; empty: the paper's values."),
        *(
            dataclasses.replace(row, read_only=row.name not in CONDITION_PARAMETERS)
            for row in settings
        ),
    ]


def node_settings(node: Node) -> Settings:
    """Return the search settings of a node's parameters. Raises `OptimizerError` if they contradict each other."""
    return settings_of({row.parameter: node.get_parameter(row.parameter).value for row in SETTINGS})
