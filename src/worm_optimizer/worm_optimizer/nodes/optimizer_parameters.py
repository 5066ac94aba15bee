# SPDX-License-Identifier: Apache-2.0
"""The optimizer node's ROS parameters: names, defaults, ranges, and the settings that they make."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from worm_optimizer.search.actuator_limits import ActuatorLimits
from worm_optimizer.search.cache import default_directory
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.search_settings import ScanSettings, Settings, robustness_of
from worm_optimizer.search.servo_limits import within
from worm_optimizer.search.task import Bounds


@dataclass(frozen=True)
class _Row:
    """One parameter: its default, what it means, and its range where it has one."""

    name: str
    default: Any
    description: str
    low: float | None = None
    high: float | None = None

    def descriptor(self) -> ParameterDescriptor:
        # A new descriptor each time: declaring a parameter changes the one that it is given.
        descriptor = ParameterDescriptor(description=self.description, read_only=True)
        if self.low is not None and self.high is not None:
            if isinstance(self.default, int):
                span = IntegerRange(from_value=int(self.low), to_value=int(self.high))
                descriptor.integer_range = [span]
            else:
                span = FloatingPointRange(from_value=self.low, to_value=self.high)
                descriptor.floating_point_range = [span]
        return descriptor


_BOX, _SEARCH, _SCAN = Bounds(), SearchSettings(), ScanSettings()
_PLAIN = Settings()
_ROWS = (
    _Row("cache_directory", "", "Directory of cached fronts; empty: ~/.cache/worm_optimizer."),
    _Row("margin_m", math.nan, "Robustness margin, m; NaN: chosen at the cliff of the scan."),
    _Row("robustness", "margin", "What keeps gaits robust: margin, chance or any_phase."),
    _Row("probability", _PLAIN.probability, "Of keeping the grooves, for chance.", 0.0, 1.0),
    _Row("stroke_low_m", _BOX.stroke_low, "Least stroke, m.", 1e-4, 1.0),
    _Row("stroke_high_m", _BOX.stroke_high, "Greatest stroke, m.", 1e-4, 1.0),
    _Row("frequency_low_hz", _BOX.frequency_low, "Least frequency, Hz.", 1e-3, 20.0),
    _Row("frequency_high_hz", _BOX.frequency_high, "Greatest frequency, Hz.", 1e-3, 20.0),
    _Row("population", _SEARCH.population, "Population of NSGA-II.", 4, 100_000),
    _Row("generations", _SEARCH.generations, "Generations of NSGA-II.", 1, 100_000),
    _Row("seed", _SEARCH.seed, "Seed of NSGA-II and of the Monte Carlo draws.", 0, 2**32 - 1),
    _Row("scan_lowest_m", _SCAN.lowest, "Least margin of the scan, m.", 0.0, 0.1),
    _Row("scan_highest_m", _SCAN.highest, "Greatest margin of the scan, m.", 0.0, 0.1),
    _Row("scan_step_m", _SCAN.step, "Step between the margins of the scan, m.", 1e-6, 0.1),
    _Row("samples", _PLAIN.samples, "Draws of the success probability.", 1, 1_000_000),
    _Row("served_gaits", _PLAIN.served, "Gaits of a front that are kept.", 3, 100_000),
    _Row("limits.max_cable_speed_m_s", 0.0, "Greatest cable speed, m/s; 0: none.", 0.0, 100.0),
    _Row("limits.max_cable_force_n", 0.0, "Greatest cable force, N; 0: none.", 0.0, 1e5),
    _Row("limits.max_power_w", 0.0, "Greatest source power, W; 0: none.", 0.0, 1e5),
    _Row("limits.driver_file", "", "The driver's parameter file, whose limits hold; empty: none."),
    _Row("limits.servo_model", "", "Of the cable servos, with driver_file; empty: not known."),
    _Row("limits.supply_voltage_v", 0.0, "Of the servos, V; 0: what suits them.", 0.0, 100.0),
)

PARAMETER_FILE = "parameter_file"


def declare(node: Node) -> None:
    """Declares all parameters. Only the parameter file can be changed while the node runs."""
    node.declare_parameter(
        PARAMETER_FILE,
        "",
        ParameterDescriptor(description="Parameter file; empty: the paper's values."),
    )
    for row in _ROWS:
        node.declare_parameter(row.name, row.default, row.descriptor())


def cache_directory(node: Node) -> Path:
    """Where fronts are cached."""
    given = node.get_parameter("cache_directory").value
    return Path(given).expanduser() if given else default_directory()


def settings_of(node: Node) -> Settings:
    """The settings that the parameters make; raises `OptimizerError` if they do not fit together."""
    value = {row.name: node.get_parameter(row.name).value for row in _ROWS}

    def limit(name: str) -> float:
        return value[name] or math.inf

    bounds, limits = within(
        Bounds(
            *(value["stroke_low_m"], value["stroke_high_m"]),
            *(value["frequency_low_hz"], value["frequency_high_hz"]),
        ),
        ActuatorLimits(
            limit("limits.max_cable_speed_m_s"),
            limit("limits.max_cable_force_n"),
            limit("limits.max_power_w"),
        ),
        value["limits.driver_file"],
        value["limits.servo_model"],
        value["limits.supply_voltage_v"] or None,
    )
    return Settings(
        bounds=bounds,
        limits=limits,
        search=SearchSettings(value["population"], value["generations"], value["seed"]),
        scan=ScanSettings(value["scan_lowest_m"], value["scan_highest_m"], value["scan_step_m"]),
        robustness=robustness_of(value["robustness"]),
        probability=value["probability"],
        margin=None if math.isnan(value["margin_m"]) else value["margin_m"],
        samples=value["samples"],
        served=value["served_gaits"],
    )
