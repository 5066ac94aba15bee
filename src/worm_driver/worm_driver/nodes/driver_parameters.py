# SPDX-License-Identifier: Apache-2.0
"""ROS parameters of the driver, from the table `worm_msgs.driver_file`, and their conversion to settings."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_driver.control.driver_settings import DriverSettings, PowerSettings, load_body
from worm_driver.control.emergency import latch_names
from worm_driver.control.supervision import Limits
from worm_driver.errors import ConfigurationError
from worm_driver.gait.gait_player import PlayerSettings
from worm_driver.power import i2c
from worm_driver.servos.transmission import Fin, Spool
from worm_msgs.driver_file import DriverFile
from worm_msgs.parameter_rows import ParameterRow
from worm_msgs.robot_parameters import RobotParameters

HEARTBEAT = "heartbeat_s"
#: Prefixes of the names of the parameters that can be changed while the driver is configured.
_LIVE = ("limits.", "rest_duration_s", "return_speed_m_per_s", HEARTBEAT)
#: Those of `_LIVE` that a configured driver can only lower.
_BOUNDS = ("limits.", "return_speed_m_per_s")
#: Parameters that the node reads only once, after its start. Later changes would have no effect.
_AT_START = ("autostart", "stay_on_failure", "device_timeout_s")
_SIMULATED_TIME = "use_sim_time"
_POLL = 0.05  # s, period of the checks for the devices
_ROWS = tuple(
    ParameterRow(
        row.metadata["alias"],
        list(row.default) if isinstance(row.default, tuple) else row.default,
        row.metadata["meaning"],
        row.metadata.get("ge"),
        row.metadata.get("le"),
    )
    for row in dataclasses.fields(DriverFile)
)
_NAMES = frozenset(row.name for row in _ROWS)


def rows() -> list[ParameterRow]:
    """Return all parameters. Each description ends with the time at which a change takes effect."""
    return [
        dataclasses.replace(row, description=f"{row.description} {_effect(row.name)}")
        for row in _ROWS
    ]


def _effect(name: str) -> str:
    if name.startswith(_BOUNDS):
        return "Takes effect at once; it can only be lowered while the driver is configured."
    if name == HEARTBEAT:
        return "Takes effect for the next goal."
    if name.startswith(_LIVE):
        return "Takes effect at once."
    if name in _AT_START:
        return "Read only at the start of the driver, which rejects later changes."
    return "Takes effect at configure; a configured driver rejects changes until cleanup."


def check_time(node: Node) -> None:
    """Raise ConfigurationError if simulated time is requested. It would have no effect on the driver."""
    if node.get_parameter(_SIMULATED_TIME).value:
        raise ConfigurationError(
            f"{_SIMULATED_TIME} is true, but the driver uses its robot's clock: remove the parameter"
        )


def why_not_set(node: Node, parameters: Sequence[Parameter], *, configured: bool) -> str:
    """Return why parameters cannot be set now; empty if they can."""
    for parameter in parameters:
        name, value = parameter.name, parameter.value
        if name == _SIMULATED_TIME and value:
            return f"{name}: the driver uses its robot's clock, no other"
        if name in _AT_START:
            return (
                f"{name}: the driver reads it only at its start: set it in the parameter file or on the command line, "
                "and start the driver again"
            )
        if not configured or name not in _NAMES:
            continue
        if not name.startswith(_LIVE):
            return f"{name}: takes effect at configure; deactivate and clean up the driver first"
        present = node.get_parameter(name).value
        if name.startswith(_BOUNDS) and value > present:
            return (
                f"{name} is {present:g} and can only be lowered, not raised to {value:g}, while the driver is "
                "configured: deactivate and clean it up first"
            )
    return ""


def wait_for_devices(node: Node, ended: Callable[[], bool]) -> None:
    """Wait until the serial port and the I2C bus exist, for at most device_timeout_s."""
    end = time.monotonic() + node.get_parameter("device_timeout_s").value
    port, bus = (node.get_parameter(name).value for name in ("port", "i2c_bus"))
    while time.monotonic() < end and not ended():
        # A virtual robot listens on its bus when it has removed the port that a killed one left behind.
        if i2c.exists(bus) and Path(port).exists():
            return
        time.sleep(_POLL)


def body(node: Node) -> RobotParameters:
    """Return the robot parameters in the file that a parameter names. Raises ConfigurationError."""
    return load_body(node.get_parameter("parameter_file").value)


def settings(node: Node, body: RobotParameters) -> DriverSettings:
    """Return the settings from the node's parameters and those of the robot. Raises ConfigurationError."""

    def value(name: str) -> Any:
        return node.get_parameter(name).value

    i2c_bus = "" if value("i2c_bus") == "none" else value("i2c_bus")
    return DriverSettings(
        port=value("port"),
        baud_rate=value("baud_rate"),
        watchdog=value("bus_watchdog_s"),
        home_at_start=value("home_at_start"),
        rate=value("rate_hz"),
        real_time_priority=value("real_time_priority"),
        spools=tuple(
            Spool(*row)
            for row in _rows(
                node, "cable_servos.ids", "cable_servos.signs", "cable_servos.spool_radius_m"
            )
        ),
        fins=tuple(
            Fin(*row)
            for row in _rows(
                node,
                "fin_servos.ids",
                "fin_servos.forward_angle_rad",
                "fin_servos.reverse_angle_rad",
            )
        ),
        max_stroke=value("limits.max_stroke_m"),
        max_frequency=value("limits.max_frequency_hz"),
        max_cable_speed=value("limits.max_cable_speed_m_per_s"),
        fin_speed=value("fin_servos.speed_rad_per_s"),
        power=PowerSettings(
            i2c_bus,
            value("i2c_address"),
            value("ina219.shunt_resistance_ohm"),
            value("ina219.max_current_a"),
        ),
        player=PlayerSettings(
            rest_duration=value("rest_duration_s"),
            rest_samples=10 if i2c_bus else 0,
            return_speed=value("return_speed_m_per_s"),
            rest_timeout=value("rest_duration_s") + 2.0,
        ),
        limits=Limits(
            max_current=value("limits.max_servo_current_a"),
            max_load=value("limits.max_servo_load"),
            following_error=value("limits.max_following_error_m"),
            max_silence=value("limits.max_silence_s"),
        ),
        body=body,
    )


def latch_files(node: Node) -> tuple[str, ...]:
    """Return the names of the files in which the emergency stop of the node's robot is stored."""
    servos = [*_array(node, "cable_servos.ids"), *_array(node, "fin_servos.ids")]
    return latch_names(node.get_namespace(), servos, node.get_parameter("port").value)


def _rows(node: Node, *names: str) -> list[tuple[Any, ...]]:
    """Return one tuple per servo from several array parameters. Raises ConfigurationError if their lengths differ."""
    columns = [_array(node, name) for name in names]
    if len({len(column) for column in columns}) != 1:
        lengths = ", ".join(f"{n} has {len(c)}" for n, c in zip(names, columns, strict=True))
        raise ConfigurationError(f"these parameters need one entry per servo: {lengths}")
    return list(zip(*columns, strict=True))


def _array(node: Node, name: str) -> list[Any]:
    """Return an array parameter as a list. rcl reads an empty array as a parameter without a value."""
    return list(node.get_parameter_or(name, Parameter(name)).value or [])
