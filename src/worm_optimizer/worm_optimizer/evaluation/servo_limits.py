# SPDX-License-Identifier: Apache-2.0
"""Limits on gaits from the driver's parameter file (format of ROS 2 parameters) and `worm_msgs.servo_models`."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from worm_model.errors import InputError
from worm_msgs.driver_file import read_driver_file
from worm_msgs.servo_models import RPM, SERVO_MODELS, VELOCITY_UNIT, Initial
from worm_msgs.settings_file import key
from worm_msgs.yaml_file import SettingsFileError
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import Bounds

_SHUNT_RANGE = 0.32  # largest shunt voltage that an INA219 measures, V (TI SBOS448, PGA = /8)


@dataclass(frozen=True)
class Motor:
    """Motor of a servo: speeds in rad/s, torque in N·m and current in A.

    No-load speed, stall torque and stall current are those at ``voltage`` V.
    """

    voltage: float
    no_load_speed: float
    stall_torque: float
    stall_current: float
    velocity_limit: float
    measures_current: bool

    def torque(self, max_current: float, max_load: float, voltage: float) -> float:
        """Return the largest torque in N·m at a supply voltage in V.

        The current is limited to ``max_current`` A. A model that does not measure its current is instead limited to the
        share ``max_load`` of its stall torque.
        """
        stall = self.stall_torque * voltage / self.voltage
        if not self.measures_current:
            return stall * max_load
        return min(stall, self.stall_torque / self.stall_current * max_current)


@dataclass(frozen=True)
class DrivenBy:
    """Limits of a robot from the driver's parameter file, in SI units.

    Attributes:
        spool_radii: spool radius of each cable servo. The cables are parallel.
        max_stroke, max_frequency, max_cable_speed: limits of a gait.
        max_servo_current: largest current of a servo that measures its current.
        max_servo_load: largest share of the stall torque for a servo that does not measure its current.
        sensor_current: range of the power sensor; infinite without a sensor.
    """

    spool_radii: tuple[float, ...]
    max_stroke: float
    max_frequency: float
    max_cable_speed: float
    max_servo_current: float
    max_servo_load: float
    sensor_current: Annotated[float, key(allow_inf_nan=True)]


def servo_models() -> dict[str, Motor]:
    """Return the servo models that the driver knows, by name."""
    return {
        row.name: Motor(
            voltage=row.nominal_voltage,
            no_load_speed=row.no_load_speed * RPM,
            stall_torque=row.stall_torque,
            stall_current=row.stall_current,
            velocity_limit=_initial(row.velocity_limit) * VELOCITY_UNIT * RPM,
            measures_current=row.measures_current,
        )
        for row in SERVO_MODELS
    }


def _initial(value: Initial) -> int:
    return value if isinstance(value, int) else value[0]


def servo_model(name: str) -> Motor | None:
    """Return the servo model with a name, which may end with the bus (-T or -R); None for an empty name.

    Raises `InputError`, with the known names, if the name is unknown.
    """
    if not name:
        return None
    models = servo_models()
    plain = name.removesuffix("-T").removesuffix("-R")  # suffix of the bus (TTL or RS-485)
    if plain not in models:
        raise InputError(f"servo model: {name!r} is none of {', '.join(models)}")
    return models[plain]


def load_driver_file(path: str | Path) -> DrivenBy:
    """Return the limits in the driver's parameter file. Raises `InputError` if `read_driver_file` rejects it."""
    try:
        row = read_driver_file(path)
    except SettingsFileError as error:
        raise InputError(str(error)) from None
    sensor = min(row.max_current, _SHUNT_RANGE / row.shunt_resistance)
    return DrivenBy(
        spool_radii=row.spool_radii,
        max_stroke=row.max_stroke,
        max_frequency=row.max_frequency,
        max_cable_speed=row.max_cable_speed,
        max_servo_current=row.max_servo_current,
        max_servo_load=row.max_servo_load,
        sensor_current=sensor if row.has_sensor else math.inf,
    )


def limits_of(driver: DrivenBy, model: Motor | None, voltage: float | None) -> ActuatorLimits:
    """Return the limits of a driver and its cable servos.

    Without a model, only the driver's limits apply: the limit of the cable speed and, if the supply ``voltage`` (V) is
    given, the limit of the power. With a model, a ``voltage`` of None means the nominal voltage of the model. Parallel
    cables share the force equally.
    """
    volts = voltage or (model.voltage if model else math.inf)
    power = driver.sensor_current * volts
    if model is None:
        return ActuatorLimits(driver.max_cable_speed, electrical_power=power)
    slimmest, widest = min(driver.spool_radii), max(driver.spool_radii)
    ratio, cables = volts / model.voltage, len(driver.spool_radii)
    no_load = model.no_load_speed * ratio
    torque = model.torque(driver.max_servo_current, driver.max_servo_load, volts)
    return ActuatorLimits(
        cable_speed=min(
            driver.max_cable_speed, slimmest * model.velocity_limit, slimmest * no_load
        ),
        cable_force=cables * torque / widest,
        electrical_power=power,
        stall_force=cables * model.stall_torque * ratio / widest,
        no_load_speed=slimmest * no_load,
    )


def within(
    bounds: Bounds, limits: ActuatorLimits, file: str, model: str, voltage: float | None
) -> tuple[Bounds, ActuatorLimits]:
    """Return a box and limits, tightened to those of the driver's parameter file and a servo model.

    An empty ``file`` changes nothing. Raises `InputError` if the file, the model or the supply ``voltage`` (V) is
    invalid, if the box becomes empty, or if a model or a voltage is given without a file.
    """
    known = servo_model(model)
    if voltage is not None and not 0.0 < voltage < math.inf:
        raise InputError(f"supply voltage: {voltage} V: give a finite positive number")
    if not file:
        if model or voltage is not None:
            raise InputError(
                "servo model and supply voltage have no effect without the driver's parameter file, "
                "which contains the spool radii: give this file, too"
            )
        return bounds, limits
    driver = load_driver_file(file)
    box = dataclasses.replace(
        bounds,
        stroke_high=min(bounds.stroke_high, driver.max_stroke),
        frequency_high=min(bounds.frequency_high, driver.max_frequency),
    )
    return box, limits.tightened(limits_of(driver, known, voltage))
