# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver in one table: name, default, description and range, and reader of the driver's file.

The driver declares them as ROS parameters. The optimizer reads the limits of gaits from the driver's parameter file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from worm_msgs.ros_parameter_file import matches, read_sections
from worm_msgs.settings_file import key, settings_of
from worm_msgs.yaml_file import SettingsFileError

_USUAL_NAME = "/worm/driver"  # name of a driver whose parameter file contains no full name
#: Parameters that rclpy declares or reads itself, in each node.
_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides.")


def _row(
    name: str, default: Any, description: str, low: Any = None, high: Any = None, **bounds: Any
) -> Any:
    """Return a row of the table, as a dataclass field; ``bounds`` are further arguments of pydantic.Field."""
    limits = {} if low is None else {"ge": low, "le": high}
    of_file = {"alias": name, **limits, **bounds}  # for pydantic.Field
    return field(default=default, metadata={"meaning": description, **of_file})


@dataclass(frozen=True)
class DriverFile:
    """Parameters of the driver, in SI units. A name may end with the unit. A missing key has its default."""

    autostart: bool = _row(
        "autostart", False, "Configure and activate at the start, without a lifecycle manager."
    )
    stay_on_failure: bool = _row(
        "stay_on_failure",
        False,
        "true: if autostart cannot configure the driver, wait for an operator; false: end, so that systemd starts the "
        "driver again.",
    )
    device_timeout: float = _row(
        "device_timeout_s",
        0.0,
        "Longest wait at the start until the serial port and the I2C bus exist.",
        0.0,
        3600.0,
    )
    parameter_file: str = _row(
        "parameter_file",
        "",
        "YAML with rear_mass, front_mass, initial_length, pitch; empty: the paper's values.",
    )
    port: str = _row("port", "/dev/worm_bus", "Serial device of the servo bus.")
    baud_rate: int = _row("baud_rate", 1_000_000, "bit/s, as set in the servos.", 9600, 4_000_000)
    rate: float = _row("rate_hz", 100.0, "Rate of commands and telemetry.", 10.0, 100.0)
    real_time_priority: int = _row(
        "real_time_priority",
        40,
        "SCHED_FIFO priority of the servo thread, with locked memory; half of it for the other threads; 0: none.",
        0,
        99,
    )
    watchdog: float = _row(
        "bus_watchdog_s",
        0.08,
        "Time without packets after which the servos stop by themselves.",
        0.04,
        2.0,
    )
    home_at_start: bool = _row(
        "home_at_start",
        False,
        "If the robot is not homed at configure, use its present length as the initial length.",
    )
    i2c_bus: str = _row(
        "i2c_bus",
        "1",
        "Number or device of the I2C bus, or socket of a virtual robot; empty or none: no sensor.",
    )
    i2c_address: int = _row("i2c_address", 0x40, "Address of the INA219.", 0x40, 0x4F)
    shunt_resistance: float = _row(
        "ina219.shunt_resistance_ohm", 0.1, "Resistance of the shunt.", 1e-4, 10.0
    )
    max_current: float = _row(
        "ina219.max_current_a",
        3.2,
        "Highest current; a sample above it is an overflow.",
        0.01,
        100.0,
    )
    cable_ids: tuple[int, ...] = _row("cable_servos.ids", (1,), "Ids of the cable servos.")
    cable_signs: tuple[int, ...] = _row(
        "cable_servos.signs", (1,), "1: rising ticks shorten the body; -1: they lengthen it."
    )
    spool_radii: tuple[Annotated[float, key(gt=0.0)], ...] = _row(
        "cable_servos.spool_radius_m",
        (0.025,),
        "Radii of the spools, to the middle of the cable.",
        min_length=1,
    )
    fin_ids: tuple[int, ...] = _row(
        "fin_servos.ids", (11, 12), "Ids of the fin servos, from rear to front."
    )
    forward_angles: tuple[float, ...] = _row(
        "fin_servos.forward_angle_rad", (2.356, 2.356), "Servo angles for forward gaits."
    )
    reverse_angles: tuple[float, ...] = _row(
        "fin_servos.reverse_angle_rad", (3.927, 3.927), "Servo angles for reverse gaits."
    )
    fin_speed: float = _row(
        "fin_servos.speed_rad_per_s", 3.0, "Speed of the fins' rotation.", 0.1, 6.0
    )
    max_stroke: float = _row(
        "limits.max_stroke_m", 0.09, "Largest stroke plus pretension.", 1e-3, 1.0
    )
    max_frequency: float = _row("limits.max_frequency_hz", 0.4, "Highest frequency.", 0.01, 5.0)
    max_cable_speed: float = _row(
        "limits.max_cable_speed_m_per_s", 0.12, "Largest cable speed.", 1e-3, 2.0
    )
    max_servo_current: float = _row(
        "limits.max_servo_current_a",
        2.0,
        "Highest current of a cable servo; more for five cycles is a fault.",
        0.05,
        5.0,
    )
    max_servo_load: float = _row(
        "limits.max_servo_load",
        0.9,
        "Highest load ratio of a cable servo without a current sensor (XL430); more for five cycles is a fault.",
        0.1,
        1.0,
    )
    max_following_error: float = _row(
        "limits.max_following_error_m",
        0.015,
        "Largest difference of cable and command; more for five cycles is a fault.",
        1e-3,
        0.2,
    )
    max_silence: float = _row(
        "limits.max_silence_s",
        0.035,
        "Longest time without an answer of a servo; more is a fault.",
        0.0,
        2.0,
    )
    rest_duration: float = _row("rest_duration_s", 1.0, "Shortest rest before a gait.", 0.1, 60.0)
    heartbeat: float = _row(
        "heartbeat_s",
        0.0,
        "Time without a heartbeat after which a run ends at its next point of rest; 0: only the timeout in the goal "
        "counts.",
        0.0,
        60.0,
    )
    return_speed: float = _row(
        "return_speed_m_per_s", 0.05, "Peak cable speed of a return to rest.", 1e-3, 0.5
    )

    @property
    def has_sensor(self) -> bool:
        """True if the driver reads a power sensor."""
        return self.i2c_bus not in ("", "none")


def read_driver_file(path: str | Path) -> DriverFile:
    """Return the parameters that the driver reads from its ROS parameter file.

    Names, types and ranges are checked as by the driver. Whether the parameters agree with each other, such as ids and
    the lengths of arrays, only the driver checks.

    Raises:
        SettingsFileError: The file is invalid, has no parameters of a driver, or those of several. The message begins
            with the path.
    """
    sections = read_sections(path)
    names = sorted({name for pattern, _ in sections for name in _driver_names(pattern)})
    if len(names) > 1:
        raise SettingsFileError(
            f"{path}: has parameters of several drivers, {', '.join(names)}; copy those of one driver to a file"
        )
    name = names[0] if names else _USUAL_NAME
    own = [parameters for pattern, parameters in sections if matches(pattern, name)]
    if not own:
        others = ", ".join(pattern for pattern, _ in sections)
        raise SettingsFileError(
            f"{path}: has no ros__parameters of {name}" + (f", only of {others}" if others else "")
        )
    merged = {key: value for parameters in own for key, value in parameters.items()}
    try:
        return settings_of(
            {key: value for key, value in merged.items() if not key.startswith(_OF_ROS)}, DriverFile
        )
    except SettingsFileError as error:
        raise SettingsFileError(f"{path}: {error}") from None


def _driver_names(pattern: str) -> list[str]:
    """Return the full name of the driver that a section names; none if its namespace has wildcards or is any."""
    *namespace, node = pattern.split("/")[1:]
    named = node == "driver" or (namespace and node in ("*", "**"))
    return ["/".join(["", *namespace, "driver"])] if named and "*" not in "".join(namespace) else []
