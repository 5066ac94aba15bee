# SPDX-License-Identifier: Apache-2.0
"""Settings file of the virtual robot: one frozen dataclass per section, validated."""

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from pathlib import Path
from random import Random
from typing import Annotated, Literal

from worm_driver.virtual_robot.plant import PlantEffects
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES, MODELS, VirtualServoModel
from worm_driver.virtual_robot.wire.packet import HIGHEST_ID
from worm_msgs.conditions import LEVEL, Conditions
from worm_msgs.robot_parameters import ROWS, RobotParameters
from worm_msgs.settings_file import OneOf, key, settings_of
from worm_msgs.yaml_file import SettingsFileError, read_yaml

DEFAULT_FILE = Path(str(files("worm_driver").joinpath("config/virtual_robot.yaml")))

# Parameters that are measured with a ruler or a scale; `true_body` does not change them.
_MEASURED = ("rear_mass", "front_mass", "unstressed_length", "initial_length", "pitch")

ServoNumber = Annotated[int, key(ge=0, le=HIGHEST_ID)]
Model = Annotated[VirtualServoModel, OneOf(MODELS)]


@dataclass(frozen=True)
class LineSettings:
    """Settings of the serial line and of all servos on it. Units are in the keys; the baud rate is in bit/s."""

    baud_rate: Annotated[int, OneOf(BAUD_RATES)]
    boot_time: Annotated[float, key("boot_time_s", ge=0.0)]


@dataclass(frozen=True)
class CableServoSettings:
    """Servo of the cable.

    Attributes:
        sign: 1 if an increasing position shortens the body, else -1.
        spool_radius: distance from the spool's axis to the middle of the cable, m.
        start_angle: shaft angle at the start, rad.
    """

    id: ServoNumber
    model: Model
    sign: Annotated[int, OneOf((1, -1))]
    spool_radius: Annotated[float, key("spool_radius_m", gt=0.0)]
    start_angle: Annotated[float, key("start_angle_rad")]


@dataclass(frozen=True)
class FinServoSettings:
    """Servo that turns the fins of a module. Angles are shaft angles in rad."""

    id: ServoNumber
    model: Model
    module: Literal["rear", "front"]
    forward_angle: Annotated[float, key("forward_angle_rad")]
    reverse_angle: Annotated[float, key("reverse_angle_rad")]
    start_angle: Annotated[float, key("start_angle_rad")]


@dataclass(frozen=True)
class SupplySettings:
    """Electrical source. power_noise: standard deviation of the noise of the power in each step, W."""

    voltage: Annotated[float, key("voltage_V", gt=0.0)]
    resistance: Annotated[float, key("resistance_ohm", ge=0.0)]
    power_noise: Annotated[float, key("power_noise_W", ge=0.0)]


@dataclass(frozen=True)
class SensorSettings:
    """INA219.

    Attributes:
        address: 7-bit address.
        shunt: resistance of the shunt, ohm.
        shunt_noise, bus_noise: standard deviations of the noise of one conversion without averaging, V.
    """

    address: Annotated[int, key(ge=0, le=127)]
    shunt: Annotated[float, key("shunt_ohm", gt=0.0)]
    shunt_noise: Annotated[float, key("shunt_noise_V", ge=0.0)]
    bus_noise: Annotated[float, key("bus_noise_V", ge=0.0)]


@dataclass(frozen=True)
class TrackerSettings:
    """Camera. occlusion_rate: occlusions of a marker per second; occlusion: duration of one occlusion, s."""

    rate: Annotated[float, key("rate_Hz", gt=0.0)]
    noise: Annotated[float, key("noise_m", ge=0.0)]
    occlusion_rate: Annotated[float, key("occlusion_rate_Hz", ge=0.0)]
    occlusion: Annotated[float, key("occlusion_s", ge=0.0)]


@dataclass(frozen=True)
class RobotSettings:
    """Settings of a virtual robot.

    Attributes:
        seed: seed of the robot and the pipe. Together with ``recording`` it is also the seed of the noise.
        step: step of the integration, s.
        fin_tolerance: largest deviation from the forward or reverse angle at which a fin servo counts as set to this
            direction, rad.
        parameter_spread: spread of the random factors on the parameters of the body, see `true_body`.
        recording: number of a recording of the same robot in the same pipe, with other noise.
    """

    seed: int
    step: Annotated[float, key("step_s", gt=0.0, le=0.001)]
    body: RobotParameters
    effects: PlantEffects
    line: Annotated[LineSettings, key("servos")]
    cable_servos: Annotated[tuple[CableServoSettings, ...], key(min_length=1)]
    fin_tolerance: Annotated[float, key("fin_tolerance_rad", ge=0.0)]
    fin_servos: Annotated[tuple[FinServoSettings, ...], key(min_length=1)]
    supply: SupplySettings
    power_sensor: SensorSettings
    tracker: TrackerSettings
    conditions: Conditions = LEVEL
    parameter_spread: Annotated[float, key(ge=0.0)] = 0.0
    recording: int = 0

    @property
    def true_body(self) -> RobotParameters:
        """True parameters: ``body`` with a random log-normal factor on each parameter of the paper's model.

        Masses, body lengths (L_free, L0) and the pitch, which can be measured, do not change. Neither do dry friction
        and loads, which the paper does not contain. ``parameter_spread`` is the standard deviation of the logarithm of
        the factors.
        """
        if not self.parameter_spread:
            return self.body
        random = Random(f"{self.seed} body")
        changed = {
            field.name: getattr(self.body, field.name)
            * math.exp(random.gauss(0.0, self.parameter_spread))
            for field in fields(self.body)
            if field.default  # Parameters with the default 0 are effects that the paper does not contain.
            and field.name not in _MEASURED
        }
        return replace(self.body, **changed)


def load_settings(path: Path | None = None) -> RobotSettings:
    """Return the settings in a file (None: the installed file). Raises SettingsFileError."""
    path = DEFAULT_FILE if path is None else path
    content = read_yaml(path)
    try:
        robot = settings_of(content, RobotSettings)
        _check_body(robot.body, content["body"])
        if {servo.module for servo in robot.fin_servos} != {"rear", "front"}:
            raise SettingsFileError("fin_servos: both modules, rear and front, need a servo")
        _check_shared_line([*robot.cable_servos, *robot.fin_servos], robot.supply.voltage)
    except SettingsFileError as error:
        raise SettingsFileError(f"{path}: {error}") from None
    return robot


def _check_body(body: RobotParameters, given: Container[str]) -> None:
    """Raise SettingsFileError unless all parameters of the paper's model are given and positive."""
    for name in ROWS:
        value, of_paper = getattr(body, name), bool(getattr(RobotParameters, name))
        if of_paper and name not in given:
            raise SettingsFileError(f"body: {name} is missing")
        if of_paper and value <= 0:
            raise SettingsFileError(f"body: {name} must be positive, not {value:g}")


def _check_shared_line(
    servos: Sequence[CableServoSettings | FinServoSettings], voltage: float
) -> None:
    """Raise SettingsFileError unless all servos can share one bus and one supply (V)."""
    if len({servo.id for servo in servos}) != len(servos):
        raise SettingsFileError("two servos have the same id")
    for servo in servos:
        low, high = servo.model.supply_range
        if not low <= voltage <= high:
            raise SettingsFileError(
                f"servo {servo.id}: a {servo.model.name} needs {low} to {high} V, "
                f"but the supply has {voltage} V"
            )
