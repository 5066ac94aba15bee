# SPDX-License-Identifier: Apache-2.0
"""ROS parameters of the driver, from the table `worm_msgs.driver_file`, and their conversion to settings."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_driver.control.driver_settings import PARAMETER_NAMES, DriverSettings, load_body
from worm_driver.control.emergency import latch_names
from worm_driver.driver_errors import ConfigurationError
from worm_driver.power import i2c
from worm_msgs.driver_file import DriverFile
from worm_msgs.parameter_rows import ParameterRow

HEARTBEAT = "heartbeat_s"
#: Prefix of the parameters that a configured driver can lower, with effect at once.
_LIMITS = "limits."
#: Parameters that the node reads only once, after its start. Later changes would have no effect.
_AT_START = ("autostart", "stay_on_failure", "device_timeout_s")
_SIMULATED_TIME = "use_sim_time"
_POLL = 0.05  # s, period of the checks for the devices
_FIELDS = dataclasses.fields(DriverFile)
_ARRAYS = frozenset(row.metadata["alias"] for row in _FIELDS if isinstance(row.default, tuple))


def rows() -> list[ParameterRow]:
    """Return all parameters. Each description ends with the time at which a change takes effect."""
    return [
        ParameterRow(
            row.metadata["alias"],
            list(row.default) if isinstance(row.default, tuple) else row.default,
            f"{row.metadata['meaning']} {_effect(row.metadata['alias'])}",
            row.metadata.get("ge"),
            row.metadata.get("le"),
        )
        for row in _FIELDS
    ]


def _effect(name: str) -> str:
    if name.startswith(_LIMITS):
        return "Takes effect at once; it can only be lowered while the driver is configured."
    if name == HEARTBEAT:
        return "Takes effect for the next goal."
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
        if not configured or name not in PARAMETER_NAMES.values() or name == HEARTBEAT:
            continue
        present = node.get_parameter(name).value
        if name.startswith(_LIMITS) and value > present:
            return (
                f"{name} is {present:g} and can only be lowered, not raised to {value:g}, while the driver is "
                "configured: deactivate and clean it up first"
            )
        if not name.startswith(_LIMITS):
            return f"{name}: takes effect at configure; deactivate and clean up the driver first"
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


def settings(node: Node) -> DriverSettings:
    """Return the settings from the node's parameters and those of the robot in a file. Raises ConfigurationError."""
    given = {name: _value(node, alias) for name, alias in PARAMETER_NAMES.items()}
    return DriverSettings(**given, body=load_body(given["parameter_file"]))


def with_limits(settings: DriverSettings, node: Node) -> DriverSettings:
    """Return settings with the present limits."""
    names = {name: alias for name, alias in PARAMETER_NAMES.items() if alias.startswith(_LIMITS)}
    return dataclasses.replace(
        settings, **{name: _value(node, alias) for name, alias in names.items()}
    )


def latch_files(node: Node) -> tuple[str, ...]:
    """Return the names of the files in which the emergency stop of the node's robot is stored."""
    servos = [*_value(node, "cable_servos.ids"), *_value(node, "fin_servos.ids")]
    return latch_names(node.get_namespace(), servos, _value(node, "port"))


def _value(node: Node, name: str) -> Any:
    """Return the value of a parameter, an array as a tuple. rcl reads an empty array as a parameter without a value."""
    value = node.get_parameter_or(name, Parameter(name)).value
    return tuple(value or ()) if name in _ARRAYS else value
