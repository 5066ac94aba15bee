# SPDX-License-Identifier: Apache-2.0
"""Settings file of the virtual robot: one frozen dataclass per section, validated."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from importlib.resources import files
from pathlib import Path
from random import Random
from typing import Any, TypeVar, get_type_hints

import yaml

from worm_driver.virtual_robot.plant import Conditions, PlantEffects
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES, MODELS, ServoModel
from worm_driver.virtual_robot.wire.packet import HIGHEST_ID
from worm_msgs.robot_parameters import ROWS, RobotParameters

DEFAULT_FILE = Path(str(files("worm_driver").joinpath("config/virtual_robot.yaml")))

# Parameters that a ruler or a scale measures are not perturbed by the seed.
_MEASURED = ("rear_mass", "front_mass", "unstressed_length", "initial_length", "pitch")
_SUFFIXES = ("_N_per_m", "_s", "_m", "_N", "_rad", "_ohm", "_V", "_W", "_Hz")
_CONDITION_RANGES = {  # values beyond them are probably in a wrong unit
    "slope_deg": (-90.0, 90.0),
    "tether_n": (0.0, 1e3),
    "tether_n_per_m": (0.0, 1e3),
    "distance_m": (0.0, 1e4),
    "flow_m_per_s": (-10.0, 10.0),
    "drag_area_m2": (0.0, 1.0),
}

T = TypeVar("T")


class SettingsError(ValueError):
    """Invalid settings; the message names the key and the problem."""


@dataclass(frozen=True)
class LineSettings:
    """What all servos have in common: bit/s, s, s."""

    baud_rate: int
    return_delay: float
    boot_time: float


@dataclass(frozen=True)
class CableServoSettings:
    """A servo that winds the cable. sign: 1 if a growing position shortens; m, rad."""

    id: int
    model: ServoModel
    sign: int
    spool_radius: float
    start_angle: float


@dataclass(frozen=True)
class FinServoSettings:
    """A servo that turns the fins of a module ("rear" or "front"); angles in rad."""

    id: int
    model: ServoModel
    module: str
    forward_angle: float
    reverse_angle: float
    start_angle: float


@dataclass(frozen=True)
class SupplySettings:
    """The electrical source: V, ohm, W."""

    voltage: float
    resistance: float
    power_noise: float


@dataclass(frozen=True)
class SensorSettings:
    """The INA219: 7-bit address, ohm, V, V."""

    address: int
    shunt: float
    shunt_noise: float
    bus_noise: float


@dataclass(frozen=True)
class TrackerSettings:
    """The camera: Hz, m, Hz, s, s."""

    rate: float
    noise: float
    occlusion_rate: float
    occlusion: float
    latency: float


@dataclass(frozen=True)
class RobotSettings:
    """All of a virtual robot; each recording of it has noise of its own, in the same pipe."""

    seed: int
    step: float
    body: RobotParameters
    effects: PlantEffects
    line: LineSettings
    cable_servos: tuple[CableServoSettings, ...]
    fin_tolerance: float
    fin_servos: tuple[FinServoSettings, ...]
    supply: SupplySettings
    power_sensor: SensorSettings
    tracker: TrackerSettings
    conditions: Conditions = field(default_factory=Conditions)
    parameter_spread: float = 0.0
    recording: int = 0

    def with_seed(self, seed: int) -> "RobotSettings":
        """The same robot with another seed."""
        return replace(self, seed=seed)


def perturbed(body: RobotParameters, spread: float, random: Random) -> RobotParameters:
    """The parameters that only an identification tells, moved by a relative spread (log-normal)."""
    moved = {
        field.name: getattr(body, field.name) * math.exp(random.gauss(0.0, spread))
        for field in fields(body)
        if field.default
        and field.name not in _MEASURED  # without effects that the paper's model lacks
    }
    return replace(body, **moved)


def load_settings(path: Path | None = None) -> RobotSettings:
    """The settings of a file, None: the installed one. Raises SettingsError."""
    return read_settings(DEFAULT_FILE if path is None else path, _robot)


def read_settings(path: Path, build: Callable[[Any], T]) -> T:
    """What is built of a YAML file's content. Raises SettingsError, also build's, with the name of the file."""
    try:
        return build(yaml.safe_load(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise SettingsError(f"{path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path}: no YAML: {' '.join(str(error).split())}") from error
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from error


def _robot(content: Any) -> RobotSettings:
    top = _names(content, "the file")
    sections: dict[str, Any] = {
        "body": RobotParameters,
        "effects": PlantEffects,
        "conditions": Conditions,
        "line": LineSettings,
        "supply": SupplySettings,
        "power_sensor": SensorSettings,
        "tracker": TrackerSettings,
    }
    if "servos" in top:
        top["line"] = top.pop("servos")
    for name, kind in sections.items():
        if name in top:
            top[name] = _section(kind, top[name], name)
    for name, kind in (("cable_servos", CableServoSettings), ("fin_servos", FinServoSettings)):
        if name in top:
            top[name] = _servos(kind, top[name], name)
    robot = _build(RobotSettings, top, "the file")
    _check(robot)
    return robot


def _servos(kind: type[T], content: Any, place: str) -> tuple[T, ...]:
    if not isinstance(content, list) or not content:
        raise SettingsError(f"{place} must be a list with at least one servo")
    return tuple(_section(kind, item, f"{place}[{i}]") for i, item in enumerate(content))


def _section(kind: type[T], content: Any, place: str) -> T:
    values = _names(content, place, {row.name for row in fields(kind)})  # type: ignore[arg-type]
    if "model" in values:
        if values["model"] not in MODELS:
            raise SettingsError(f"{place}: no model {values['model']!r} ({', '.join(MODELS)})")
        values["model"] = MODELS[values["model"]]
    return _build(kind, values, place)


def _names(content: Any, place: str, known: Collection[str] = ()) -> dict[str, Any]:
    """Return a mapping without the unit suffixes of its names, except for known names that have one."""
    if not isinstance(content, Mapping):
        raise SettingsError(f"{place} must be a mapping of names to values")
    return {
        name if name in known else _without_unit(str(name)): value
        for name, value in content.items()
    }


def _without_unit(name: str) -> str:
    return next((name.removesuffix(end) for end in _SUFFIXES if name.endswith(end)), name)


def _build(kind: type[T], values: dict[str, Any], place: str) -> T:
    wanted = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    types = get_type_hints(kind)
    unknown = sorted(set(values) - set(wanted))
    if unknown:
        raise SettingsError(f"{place}: unknown name {unknown[0]!r} ({', '.join(wanted)})")
    needed = {name for name, field in wanted.items() if _is_needed(field)}
    missing = sorted(needed - set(values))
    if missing:
        raise SettingsError(f"{place}: {missing[0]!r} is missing")
    for name, value in values.items():
        values[name] = _checked(value, types[name], f"{place}: {name}")
    return kind(**values)


def _is_needed(field: Field[Any]) -> bool:
    """Return whether a file must have a value: all without a default, and of the body what the paper's robot has."""
    required = field.default is MISSING and field.default_factory is MISSING
    return required or (field.name in ROWS and bool(field.default))


def _checked(value: Any, kind: Any, place: str) -> Any:
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SettingsError(f"{place} must be a number, not {value!r}")
        if not math.isfinite(value):
            raise SettingsError(f"{place} must be finite, not {value!r}")
        return float(value)
    if kind is int and (isinstance(value, bool) or not isinstance(value, int)):
        raise SettingsError(f"{place} must be a whole number, not {value!r}")
    return value


def _check(robot: RobotSettings) -> None:
    for key, row in ROWS.items():
        value = getattr(robot.body, key)
        if getattr(RobotParameters, key) and value <= 0:
            raise SettingsError(f"body: {key} must be positive")
        if not row["low"] <= value <= row["high"]:
            raise SettingsError(
                f"body: {key} is {value:g} {row['unit']}; use {row['low']:g} to {row['high']:g} {row['unit']}"
            )
    check_conditions(robot.conditions)
    if not 0 < robot.step <= 0.001:
        raise SettingsError("step_s must be above 0 and at most 0.001")
    if robot.line.baud_rate not in BAUD_RATES:
        raise SettingsError(f"servos: baud_rate must be one of {', '.join(map(str, BAUD_RATES))}")
    if any(servo.sign not in (1, -1) for servo in robot.cable_servos):
        raise SettingsError("cable_servos: sign must be 1 or -1")
    if {servo.module for servo in robot.fin_servos} != {"rear", "front"}:
        raise SettingsError("fin_servos: each needs module rear or front, and both modules a servo")
    _check_shared_line([*robot.cable_servos, *robot.fin_servos], robot.supply.voltage)


def check_conditions(conditions: Conditions) -> None:
    """Raise SettingsError unless the conditions are admissible."""
    for name, (low, high) in _CONDITION_RANGES.items():
        value = getattr(conditions, name)
        if not low <= value <= high:
            raise SettingsError(f"conditions: {name} is {value:g}; use {low:g} to {high:g}")


def _check_shared_line(
    servos: Sequence[CableServoSettings | FinServoSettings], voltage: float
) -> None:
    """Raise SettingsError unless all servos can share one bus and one supply (V)."""
    if len({servo.id for servo in servos}) != len(servos):
        raise SettingsError("two servos have the same id")
    for servo in servos:
        if not 0 <= servo.id <= HIGHEST_ID:
            raise SettingsError(f"servo {servo.id}: an id is 0 to {HIGHEST_ID}")
        low, high = servo.model.supply_range
        if not low <= voltage <= high:
            raise SettingsError(
                f"servo {servo.id}: a {servo.model.name} takes {low} to {high} V, "
                f"but the supply has {voltage} V"
            )
