# SPDX-License-Identifier: Apache-2.0
"""Files of studies, and the points that they describe. docs/studies.md lists the keys.

Values that exclude each other at a point, such as a groove phase beyond half a pitch, are detected when the point is
computed (`point.content_of`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from worm_model.arrays import Array
from worm_model.errors import InputError
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import MAX_FREQUENCY, MAX_MARGIN, MAX_STROKE
from worm_msgs.robot_parameters import ROWS
from worm_msgs.settings_file import Converted, OneOf, key, read_settings
from worm_optimizer.code_version import code_identity
from worm_optimizer.search.exact import Resolution as ScanResolution
from worm_optimizer.search.search_settings import ScanSettings

# Names of the dimensions that do not belong to a single quantity
PARAMETER_FILE, SAMPLE = "parameter_file", "sample"
COMPUTABLE = ("front", "gaits", "cliff", "success", "any_phase")
MOST_POINTS = 1_000_000  # of a study, whose results are in memory at the end
_MOST_VALUES = 100_000  # largest number of evenly spaced values of a quantity
_MOST_BLOCKS = 1000  # a killed study loses a thousandth of its time for each worker

_FINEST = 10_000  # largest number of strokes, frequencies or gaits of a front
_SMALL, _LARGE = 1e-6, 1e6  # bounds of positive quantities, in their units


class StudyError(InputError):
    """The description of a study is invalid. The message contains the key and the reason."""


@dataclass(frozen=True)
class Quantity:
    """Quantity of a study.

    Attributes:
        unit: unit.
        long_name: description.
        low, high: admissible range; a value outside is probably in another unit.
        field: field of `Bounds` or `ActuatorLimits`; empty for other quantities.
    """

    unit: str
    long_name: str
    low: float
    high: float
    field: str = ""


def _positive(unit: str, long_name: str, field: str = "") -> Quantity:
    return Quantity(unit, long_name, _SMALL, _LARGE, field)


#: Bounds of gaits
BOUNDS = {
    "min_stroke_m": Quantity("m", "shortest stroke", _SMALL, MAX_STROKE, "stroke_low"),
    "max_stroke_m": Quantity("m", "longest stroke", _SMALL, MAX_STROKE, "stroke_high"),
    "min_frequency_Hz": Quantity("Hz", "lowest frequency", _SMALL, MAX_FREQUENCY, "frequency_low"),
    "max_frequency_Hz": Quantity(
        "Hz", "highest frequency", _SMALL, MAX_FREQUENCY, "frequency_high"
    ),
}
#: Limits of the actuators
LIMITS = {
    "max_cable_speed_m_per_s": _positive("m/s", "highest cable speed", "cable_speed"),
    "max_cable_force_N": _positive("N", "highest cable force", "cable_force"),
    "max_power_W": _positive("W", "highest source power", "electrical_power"),
    "stall_force_N": _positive("N", "cable force at which the motors stall", "stall_force"),
    "no_load_speed_m_s": _positive("m/s", "cable speed of the motors without load", "no_load_speed"),
    "max_push_force_N": _positive("N", "highest pushing force in the model's cable", "pushing_force"),
}  # fmt: skip
# Units in the notation of the CF conventions
_CF_UNITS = {"°": "degree", "deg": "degree", "m²": "m2", "N·s/m": "N s/m"}


def _described(row: Mapping, long_name: str) -> Quantity:
    unit = _CF_UNITS.get(row["unit"], row["unit"])
    return Quantity(unit, long_name, row["low"], row["high"])


#: Quantities that a study may vary or fix: keys of a parameter file, conditions in the pipe, and others.
QUANTITIES: Mapping[str, Quantity] = {
    **{k: _described(row, f"{k.replace('_', ' ')} ({row['paper']})") for k, row in ROWS.items()},
    **{k: _described(row, row["meaning"]) for k, row in CONDITION_ROWS.items()},
    "margin_m": Quantity("m", "robustness margin", 0.0, MAX_MARGIN),
    "direction": Quantity("1", "direction: 1 forward, -1 reverse", -1.0, 1.0),
    "groove_phase_m": Quantity("m", "groove phase", -0.1, 0.1),
    **BOUNDS,
    **LIMITS,
    "at_power_W": _positive("W", "power of the gait max_speed_at_power"),
    "at_speed_m_s": _positive("m/s", "speed of the gait min_power_at_speed"),
}
_Name = Annotated[str, OneOf(tuple(QUANTITIES))]


@dataclass(frozen=True)
class Range:
    """Range of a quantity that is sampled."""

    low: float
    high: float


def _number(name: str, value: Any) -> float:
    """Return the value of a quantity. Raises `StudyError` if it is not admissible."""
    quantity = QUANTITIES[name]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and quantity.low <= value <= quantity.high):
        hint = "YAML reads 1e-3 as text: write 1.0e-3" if isinstance(value, str) else ""
        raise StudyError(
            f"{name}: {value!r} is not a number from {quantity.low:g} to {quantity.high:g} {quantity.unit}; "
            f"{hint or 'is it in another unit?'}"
        )
    if name == "direction" and value not in (1, -1):
        raise StudyError(f"{name}: {value!r} is neither 1 nor -1")
    return float(value)


def _fixed(rows: Mapping[str, Any]) -> dict[str, float]:
    return {name: _number(name, value) for name, value in rows.items()}


def _varied(rows: Mapping[str, Any]) -> dict[str, tuple[float, ...] | Range]:
    return {name: _values(name, row) for name, row in rows.items()}


def _values(name: str, row: Any) -> tuple[float, ...] | Range:
    """Return the values of a quantity that varies, or the range in which it is sampled.

    Evenly spaced values are rounded to 12 digits, which removes errors of the floating-point arithmetic.
    """
    match row:
        case [_, *_]:
            values = tuple(_number(name, value) for value in row)
            if len(set(values)) < len(values):
                raise StudyError(f"{name}: contains a value twice")
            return values
        case {"range": [low, high], **others} if not others and name != "direction":
            return Range(*_ends(name, low, high))
        case {"from": low, "to": high, "count": int(count), **others} if (
            not others and 2 <= count <= _MOST_VALUES
        ):
            spaced = np.linspace(*_ends(name, low, high), count)
            return tuple(float(f"{value:.12g}") for value in spaced)
        case _:
            raise StudyError(
                f"{name}: write a list of values, {{from: A, to: B, count: N}} with N from 2 to {_MOST_VALUES}, "
                "or {range: [A, B]}"
            )


def _ends(name: str, low: Any, high: Any) -> tuple[float, float]:
    ends = _number(name, low), _number(name, high)
    if not ends[0] < ends[1]:
        raise StudyError(f"{name}: {ends[0]:g} is not below {ends[1]:g}")
    return ends


@dataclass(frozen=True)
class Resolution:
    """Resolution of the computation of a point.

    Attributes:
        strokes, frequencies: grid on which the search for edges starts, see `scan`.
        front_gaits: number of stored gaits of a front.
        samples: number of draws of a success probability.
        seed: seed of these draws.
    """

    strokes: Annotated[int, key(ge=3, le=_FINEST)] = ScanResolution.strokes
    frequencies: Annotated[int, key(ge=2, le=_FINEST)] = ScanResolution.frequencies
    front_gaits: Annotated[int, key(ge=3, le=_FINEST)] = 32
    samples: Annotated[int, key(ge=1, le=1_000_000)] = 500
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    @property
    def scan(self) -> ScanResolution:
        """Grid on which the search for edges starts."""
        return ScanResolution(self.strokes, self.frequencies)


@dataclass(frozen=True)
class Sample:
    """Sampling of all ranges: number of ``points`` and ``seed`` of the scrambled Sobol sequence."""

    points: Annotated[int, key(ge=1, le=MOST_POINTS)] = 64
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    def draw(self, axes: int) -> Array:
        """Return values between 0 and 1, shape (points, axes).

        The sequence is scrambled, because an unscrambled one begins with a point whose values are all exactly 0. A
        larger sample begins with the points of a smaller one.
        """
        from scipy.stats import qmc  # here: the import takes a second, and workers do not need it

        engine = qmc.Sobol(axes, scramble=True, seed=self.seed)
        return engine.random_base2(math.ceil(math.log2(max(self.points, 2))))[: self.points]


_SAMPLE, _RESOLUTION, _SCAN = Sample(), Resolution(), ScanSettings()


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """Content of a study's file.

    Attributes:
        title: title of the study.
        parameter_files: parameter files of the robots; empty for a single robot that the command line names.
        vary: values or range of each quantity that varies.
        sample: sampling of the ranges.
        fixed: values of the quantities that do not vary.
        compute: requested results.
        resolution: resolution of the computation.
        scan: margins of the margin scan.
    """

    title: str = "Study"
    parameter_files: tuple[str, ...] = ()
    vary: Annotated[
        Mapping[str, tuple[float, ...] | Range], Converted(dict[_Name, Any], _varied)
    ] = field(default_factory=dict)
    sample: Sample = _SAMPLE
    fixed: Annotated[Mapping[str, float], Converted(dict[_Name, Any], _fixed)] = field(
        default_factory=dict
    )
    compute: Annotated[tuple[Annotated[str, OneOf(COMPUTABLE)], ...], key(min_length=1)]
    resolution: Resolution = _RESOLUTION
    scan: ScanSettings = _SCAN

    def __post_init__(self) -> None:
        if twice := set(self.vary) & set(self.fixed):
            raise StudyError(f"{min(twice)}: is both under vary and under fixed; keep one")
        if len(set(self.parameter_files)) < len(self.parameter_files):
            raise StudyError("parameter_files: contains a file twice")
        if {"groove_phase_m", "initial_length"} <= {*self.vary, *self.fixed}:
            raise StudyError(
                "groove_phase_m: sets initial_length, but the study has initial_length, too; keep one of them"
            )
        if self.sample != _SAMPLE and not self.ranges:
            raise StudyError("sample: nothing under vary has a range to sample")
        if not self.dimensions:
            raise StudyError(
                "vary: nothing varies: name at least one quantity, or several parameter_files"
            )
        if self.size > MOST_POINTS:
            raise StudyError(
                f"vary: {self.size} points are more than {MOST_POINTS}: use fewer values, or ranges with a sample"
            )

    @property
    def margin_at_cliff(self) -> bool:
        """True if each point uses the last margin before the cliff of its own scan."""
        margin_is_given = "margin_m" in {*self.vary, *self.fixed}
        return not margin_is_given and bool({"front", "gaits", "success"} & set(self.compute))

    @property
    def ranges(self) -> dict[str, Range]:
        """Quantities that are sampled."""
        return {name: row for name, row in self.vary.items() if isinstance(row, Range)}

    @property
    def dimensions(self) -> dict[str, Sequence[float]]:
        """Dimensions of the points with their values, the slowest-varying dimension first.

        Several parameter files form one dimension, each list of values another one, and the samples of all ranges
        together the last one.
        """
        values: dict[str, Sequence[float]] = {}
        if len(self.parameter_files) > 1:
            values[PARAMETER_FILE] = range(len(self.parameter_files))
        values |= {name: row for name, row in self.vary.items() if not isinstance(row, Range)}
        if self.ranges:
            values[SAMPLE] = range(self.sample.points)
        return values

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points along each of `dimensions`."""
        return tuple(map(len, self.dimensions.values()))

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Study:
    """Study: content and ``text`` of its ``file``, and the name and parameters of each of the ``robots``."""

    file: StudyFile
    text: str
    robots: tuple[tuple[str, ParameterFile], ...]

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the columns of `points`: `PARAMETER_FILE`, even for a single file, and the quantities that vary."""
        return (PARAMETER_FILE, *self.file.vary)

    def points(self) -> Array:
        """Return the value of each of `varied` at each point, shape (size, len(varied)); for a file, its index."""
        file = self.file
        mesh = np.meshgrid(*map(np.asarray, file.dimensions.values()), indexing="ij")
        columns = dict(zip(file.dimensions, mesh, strict=True))
        if file.ranges:
            drawn = file.sample.draw(len(file.ranges)).T
            for share, (name, ends) in zip(drawn, file.ranges.items(), strict=True):
                columns[name] = (ends.low + share * (ends.high - ends.low))[columns[SAMPLE]]
        columns.setdefault(PARAMETER_FILE, np.zeros(file.shape))
        return np.stack([columns[name].ravel().astype(float) for name in self.varied], axis=-1)

    def blocks(self) -> list[Array]:
        """Return the points in blocks, of which a worker computes one at a time."""
        size = math.ceil(self.file.size / _MOST_BLOCKS)
        points = self.points()
        return [points[start : start + size] for start in range(0, len(points), size)]

    def identity(self) -> str:
        """Return a hash of the code and of all that determines the results of a point with given values.

        Two studies that differ in title and points only have the same identity.
        """
        vary = dict.fromkeys(self.file.vary, (math.nan,))
        plain = replace(self.file, title="", vary=vary, sample=_SAMPLE)
        content = f"{code_identity()} {plain} {self.robots}"
        return hashlib.sha256(content.encode()).hexdigest()[:24]


def load_study(path: Path, parameters: str = "") -> Study:
    """Read the file of a study.

    Args:
        path: YAML file. Paths in it are relative to its folder.
        parameters: parameter file of the robot, if the study names none.

    Raises:
        InputError: A file is invalid. The message begins with its path.
    """
    file = read_settings(path, StudyFile, StudyError)
    if parameters and file.parameter_files:
        raise StudyError(
            f"{path}: parameter_files: names the robots already; leave --parameters out"
        )
    named = {name: str(path.parent / name) for name in file.parameter_files}
    paths = named or {Path(parameters).name or "the paper": parameters}
    robots = tuple((name, load_parameter_file(each)) for name, each in paths.items())
    return Study(file, path.read_text(encoding="utf-8"), robots)
