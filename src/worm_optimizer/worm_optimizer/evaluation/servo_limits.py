# SPDX-License-Identifier: Apache-2.0
"""Limits on gaits from the driver's parameter file (format of ROS 2 parameters) and `worm_msgs.servo_models`."""

from __future__ import annotations

import dataclasses
import math

from worm_model.errors import InputError
from worm_msgs.driver_file import DriverFile, read_driver_file
from worm_msgs.servo_models import RPM, SERVO_MODELS, VELOCITY_UNIT, ServoRow
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.task import Bounds

_SHUNT_RANGE = 0.32  # largest shunt voltage that an INA219 measures, V (TI SBOS448, PGA = /8)


def servo_model(name: str) -> ServoRow | None:
    """Return the servo model with a name, which may end with the bus (-T or -R); None for an empty name.

    Raises `InputError`, with the known names, if the name is unknown.
    """
    if not name:
        return None
    models = {row.name: row for row in SERVO_MODELS}
    plain = name.removesuffix("-T").removesuffix("-R")  # suffix of the bus (TTL or RS-485)
    if plain not in models:
        raise InputError(f"servo model: {name!r} is none of {', '.join(models)}")
    return models[plain]


def limits_of(driver: DriverFile, model: ServoRow | None, voltage: float | None) -> ActuatorLimits:
    """Return the limits of a driver and its cable servos.

    Without a model, only the driver's limits apply: the limit of the cable speed and, if the supply ``voltage`` (V) is
    given, the limit of the power. With a model, a ``voltage`` of None means the nominal voltage of the model. Parallel
    cables share the force equally.
    """
    sensor = math.inf
    if driver.has_sensor:
        sensor = min(driver.max_current, _SHUNT_RANGE / driver.shunt_resistance)
    volts = voltage or (model.nominal_voltage if model else math.inf)
    power = sensor * volts
    if model is None:
        return ActuatorLimits(driver.max_cable_speed, electrical_power=power)
    slimmest, widest = min(driver.spool_radii), max(driver.spool_radii)
    ratio, cables = volts / model.nominal_voltage, len(driver.spool_radii)
    no_load = model.no_load_speed * RPM * ratio
    initial = model.velocity_limit
    velocity_limit = (initial if isinstance(initial, int) else initial[0]) * VELOCITY_UNIT * RPM
    torque = model.stall_torque * ratio
    if model.measures_current:
        torque = min(torque, model.torque_constant * driver.max_servo_current)
    else:
        torque *= driver.max_servo_load  # a share of the stall torque
    return ActuatorLimits(
        cable_speed=min(driver.max_cable_speed, slimmest * velocity_limit, slimmest * no_load),
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
    driver = read_driver_file(file)
    box = dataclasses.replace(
        bounds,
        stroke_high=min(bounds.stroke_high, driver.max_stroke),
        frequency_high=min(bounds.frequency_high, driver.max_frequency),
    )
    return box, limits.tightened(limits_of(driver, known, voltage))
