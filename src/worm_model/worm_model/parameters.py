# SPDX-License-Identifier: Apache-2.0
"""Parameters of the worm robot and the parameter file.

The keys are the parameters of the paper's table ``tab1``, in SI units, and some parameters that the table lacks, such
as ``initial_length`` and the dry friction of both modules (see `Parameters`). All values are numbers, except that of
``one_sided_cable``: true or false selects the power model.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from worm_model.errors import InputError
from worm_msgs.robot_parameters import ParameterFileContent, RobotParameters, TravelError, rows_of
from worm_msgs.settings_file import settings_of
from worm_msgs.yaml_file import SettingsFileError, read_yaml, unknown_name


class ParameterError(InputError):
    """A parameter or a parameter file is not admissible. The message names it and the reason."""


@dataclass(frozen=True)
class Parameters(RobotParameters):
    """Parameters of the robot in its pipe, SI units. The defaults are the values of the paper's table ``tab1``.

    The paper does not give ``initial_length`` (L0). This project calibrated it: with 0.2952 m, the cliff of the price
    of robustness is at a margin of 3.4 mm, as in the paper. L0 determines the groove phase, and with it the number of
    grooves that a cycle gains.

    ``rear_dry_friction`` and ``front_dry_friction`` (D1, D2) are not in the paper's model, which has only viscous
    friction. With the default 0 the model is the paper's.

    ``one_sided_cable`` selects the power model of a cable that cannot push: max(F_c, 0) replaces F_c in
    eq:power_model. The values of ``bellows_damping`` (c_b) and ``power_factor`` (α_P) are valid only for the power
    model with which they were fitted. The motion is the same with both power models.

    Raises `ParameterError` if a value is not a finite number or is outside its admissible range, or if two values
    exclude each other. A range spans several orders of magnitude, to detect wrong units.
    """

    one_sided_cable: bool = False

    def __post_init__(self) -> None:
        for row in rows_of(type(self)):
            object.__setattr__(self, row.name, _checked(row, getattr(self, row.name)))
        if not isinstance(self.one_sided_cable, bool):
            raise ParameterError(f"{FORM}: {self.one_sided_cable!r}: write true or false")
        if 2.0 * self.switching_threshold < self.pitch:
            # A switch changes the deflection of the fin by a pitch. If the new deflection is beyond the threshold on
            # the other side, the fin switches back at once.
            raise ParameterError(
                f"switching_threshold: {self.switching_threshold:g} m is less than half the pitch "
                f"({self.pitch:g} m): a fin that switches would switch back at once, without end"
            )
        if 2.0 * self.switching_threshold <= self.clearance:
            raise ParameterError(
                f"clearance: {self.clearance:g} m is not below twice the switching_threshold "
                f"({self.switching_threshold:g} m): the fins would never touch the grooves"
            )

    def __repr__(self) -> str:
        """Return the constructor call with the values that differ from the default, like ``Parameters(gain=0.85)``."""
        values = (
            (row.name, getattr(self, row.name), row.default) for row in dataclasses.fields(self)
        )
        own = ", ".join(f"{name}={value!r}" for name, value, default in values if value != default)
        return f"Parameters({own})"

    def replace(self, **changes: Any) -> Parameters:
        """Return a copy with changed values. Raises `ParameterError` for an unknown key or an inadmissible value."""
        unknown = set(changes) - {*KEYS, FORM}
        if unknown:
            raise ParameterError(unknown_name("parameter", sorted(unknown)[0], (*KEYS, FORM)))
        return dataclasses.replace(self, **changes)

    def as_dict(self) -> dict[str, float]:
        """Return the values by key, in the order of the table; ``one_sided_cable`` is last."""
        return dataclasses.asdict(self)


def _checked(row: dataclasses.Field[float], value: Any) -> float:
    unit, low, high = (row.metadata[key] for key in ("unit", "low", "high"))
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise ParameterError(f"{row.name}: {value!r} is not a number (unit: {unit})")
    if not math.isfinite(value):
        raise ParameterError(f"{row.name}: {value} is not a finite number (unit: {unit})")
    if not low <= value <= high:
        raise ParameterError(
            f"{row.name}: {value:g} {unit} is outside {low:g} to {high:g} {unit}; "
            f"is it in another unit? (the default of {row.metadata['paper']} is {row.default:g} {unit})"
        )
    return float(value)


#: keys of the parameters that are numbers, which are all except FORM
KEYS: tuple[str, ...] = tuple(row.name for row in rows_of(Parameters))
UNITS: Mapping[str, str] = {row.name: row.metadata["unit"] for row in rows_of(Parameters)}
SYMBOLS: Mapping[str, str] = {row.name: row.metadata["paper"] for row in rows_of(Parameters)}
FORM = "one_sided_cable"  # key of the choice of the power model, also in a file's provenance
#: keys of the parameters that affect the power, but not the motion
POWER_ONLY = frozenset(row.name for row in rows_of(Parameters) if row.metadata["power_only"])
#: keys of the parameters that the paper's model does not contain; their default is 0
NOT_OF_PAPER = tuple(row.name for row in rows_of(Parameters) if not row.default)
#: keys of the parameters that are valid only for the power model with which they were fitted
FITTED_WITH_FORM = ("bellows_damping", "power_factor")
MADE_BY = "worm_model identify"  # beginning of the entry made_by in the provenance of a file of `identify`
PAPER = Parameters()


@dataclass(frozen=True)
class ParameterFile:
    """Content of a parameter file: the values, their 95 % intervals and their provenance.

    For the meaning and the units of the mappings see `worm_msgs.robot_parameters.ParameterFileContent`. The keys of
    ``correlations`` are pairs of parameter keys. A mapping is empty if the file lacks it, and ``travel_error`` is None.
    """

    parameters: Parameters = PAPER
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    correlations: Mapping[tuple[str, str], float] = field(default_factory=dict)
    run_to_run: Mapping[str, float] = field(default_factory=dict)
    travel_error: TravelError | None = None


def _check_form(
    parameters: Parameters, keys: Container[str], provenance: Mapping[str, Any]
) -> None:
    """Raise `ParameterError` unless c_b and α_P of a file belong to the power model that the file selects.

    ``keys`` are the keys that the file contains.
    """
    form = parameters.one_sided_cable
    if form and not all(key in keys for key in FITTED_WITH_FORM):
        raise ParameterError(
            f"{FORM}: true needs {' and '.join(FITTED_WITH_FORM)} fitted with it, which the paper's values are "
            "not. Use a file that identify --one-sided-cable has written"
        )
    identified = str(provenance.get("made_by", "")).startswith(MADE_BY)
    if identified and provenance.get(FORM, False) != form:
        raise ParameterError(
            f"{FORM}: {str(form).lower()}, but identify fitted {' and '.join(FITTED_WITH_FORM)} with "
            f"{str(not form).lower()}. Restore that value, or identify again "
            f"{'with' if form else 'without'} --one-sided-cable"
        )


def parse_parameter_file(content: Any) -> ParameterFile:
    """Return the `ParameterFile` of a parsed YAML document. A missing key means the paper's value.

    Raises `ParameterError` on an unknown key, a value that is not admissible, a malformed section, or c_b and α_P that
    were fitted with another power model than ``one_sided_cable`` selects.
    """
    content = {} if content is None else content
    try:
        file = settings_of(content, ParameterFileContent)
    except SettingsFileError as error:
        raise ParameterError(str(error)) from None
    parameters = Parameters(**{name: getattr(file, name) for name in (*KEYS, FORM)})
    _check_form(parameters, content, file.provenance)
    correlations = {(first, second): value for first, second, value in file.correlations}
    return ParameterFile(
        parameters,
        file.intervals,
        file.provenance,
        correlations,
        file.run_to_run,
        file.travel_error,
    )


def load_parameter_file(path: str | Path) -> ParameterFile:
    """Return the content of a parameter file (YAML), or the paper's values if the path is empty.

    Raises `ParameterError` with a message that starts with the path.
    """
    if not str(path):
        return ParameterFile()
    content = read_yaml(Path(path), ParameterError)
    try:
        return parse_parameter_file(content)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def load_parameters(path: str | Path) -> Parameters:
    """Return the values of a parameter file; see `load_parameter_file`."""
    return load_parameter_file(path).parameters


def format_parameter_file(content: ParameterFile) -> str:
    """Return the text of a parameter file, each value with its unit and symbol as a comment."""
    lines = [
        f"{key}: {getattr(content.parameters, key)!r}  # {UNITS[key]}, {SYMBOLS[key]}"
        for key in KEYS
    ]
    form = str(content.parameters.one_sided_cable).lower()
    meaning = "true if c_b and α_P were fitted with the power model of a cable that cannot push"
    lines.append(f"{FORM}: {form}  # {meaning}")
    extra: dict[str, Any] = {}
    if content.intervals:
        extra["intervals"] = {
            key: list(map(float, bounds)) for key, bounds in content.intervals.items()
        }
    if content.correlations:
        extra["correlations"] = [
            [*pair, float(correlation)] for pair, correlation in content.correlations.items()
        ]
    if content.run_to_run:
        extra["run_to_run"] = {key: float(value) for key, value in content.run_to_run.items()}
    if content.travel_error:
        extra["travel_error"] = dataclasses.asdict(content.travel_error)
    if content.provenance:
        extra["provenance"] = dict(content.provenance)
    text = "\n".join(lines) + "\n"
    return text + (yaml.safe_dump(extra, sort_keys=False, allow_unicode=True) if extra else "")


def write_parameter_file(path: str | Path, content: ParameterFile) -> None:
    """Write a new parameter file; raise `FileExistsError` if the file exists."""
    with Path(path).open("x", encoding="utf-8") as file:
        file.write(format_parameter_file(content))
