# SPDX-License-Identifier: Apache-2.0
"""The optimizer node's ROS parameters: those of `search_settings.SETTINGS`, the parameter file and the cache."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from worm_msgs.node_command import descriptor
from worm_optimizer.search.cache import default_directory
from worm_optimizer.search.search_settings import SETTINGS, SettingRow, Settings, settings_of

PARAMETER_FILE = "parameter_file"
SCHEDULER = "scheduler"
_CACHE = SettingRow(
    "cache_directory", "cache", "", "directory of cached fronts; empty: ~/.cache/worm_optimizer"
)


def rows() -> list[tuple[str, Any, ParameterDescriptor]]:
    """Name, default and descriptor of all. Only the parameter file can be changed while the node runs."""
    about = ParameterDescriptor(description="Parameter file; empty: the paper's values.")
    meaning = "Address of a Dask scheduler whose workers judge the gaits of chance and any_phase; empty: this computer."
    scheduler = descriptor(meaning, "", None, read_only=True)
    settings = [(row.parameter, row.default, _descriptor(row)) for row in (_CACHE, *SETTINGS)]
    return [(PARAMETER_FILE, "", about), (SCHEDULER, "", scheduler), *settings]


def cache_directory(node: Node) -> Path:
    """Where fronts are cached."""
    path = node.get_parameter(_CACHE.parameter).value
    return Path(path).expanduser() if path else default_directory()


def node_settings(node: Node) -> Settings:
    """The settings that the parameters make; raises `OptimizerError` if they do not fit together."""
    return settings_of({row.parameter: node.get_parameter(row.parameter).value for row in SETTINGS})


def _descriptor(row: SettingRow) -> ParameterDescriptor:
    span = None if row.low is None or row.high is None else (row.low, row.high)
    return descriptor(row.meaning, row.default, span, read_only=True)
