# SPDX-License-Identifier: Apache-2.0
"""Studies as described by their YAML files: what varies, what is fixed, and what is computed for each point.

docs/studies.md lists the keys. All values are checked here, before the computation starts.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.stats import qmc

from worm_model.errors import InputError
from worm_model.parameters import UNITS, ParameterFile, load_parameter_file
from worm_optimizer.search.exact import Resolution as ScanResolution
from worm_optimizer.search.search_settings import ScanSettings
from worm_optimizer.search.servo_limits import DrivenBy, load_driver_file, servo_model

Array = NDArray[np.float64]

# Quantities that may vary or be fixed in addition to the keys of a parameter file, with their units.
BOX = ("min_stroke_m", "max_stroke_m", "min_frequency_Hz", "max_frequency_hz")
LIMITS = (
    *("max_cable_speed_m_per_s", "max_cable_force_N", "max_power_W"),
    *("stall_force_N", "no_load_speed_m_s"),
)
OTHER_UNITS: Mapping[str, str] = {
    "margin_m": "m",
    "direction": "1",
    "groove_phase_m": "m",
    "spool_radius_m": "m",
    **dict(zip(BOX, ("m", "m", "Hz", "Hz"), strict=True)),
    **dict(zip(LIMITS, ("m/s", "N", "W", "N", "m/s"), strict=True)),
    "at_power_W": "W",
    "at_speed_m_s": "m/s",
}
QUANTITY_UNITS: Mapping[str, str] = {**UNITS, **OTHER_UNITS}
PARAMETER_FILE = "parameter_file"  # index of the parameter file of a point
CLIFF = "cliff"  # written instead of a margin: the margin at the cliff of the point's own scan

COMPUTABLE = ("front", "gaits", "cliff", "success", "any_phase")
METHODS = ("sobol", "latin_hypercube")
MOST_POINTS = 10_000_000
_KEYS = (
    *("title", "parameters", "parameter_files", "vary", "sample", "fixed", "hardware"),
    *("compute", "resolution", "scan", "block_points"),
)
_BLOCK_SECONDS = 5.0  # approximate duration of a block on one core; submitting it takes far less
_SECONDS_PER_GAIT = 2e-5  # assumed, because the size of blocks must not depend on the machine
_FEWEST_BLOCKS = 20  # so that the progress bar of a small study advances
_PER_CELL = (
    3.0  # approximate number of gaits evaluated per stroke and frequency of an exact front's scan
)
_LIMITED = 2.0  # factor of the time with limits that need a simulated cycle
_PER_MARGIN = 1500.0  # approximate number of gaits per margin of a scan
_ANY_PHASE = 200_000.0  # approximate number of gaits of an any-phase front


class StudyError(InputError):
    """The description of a study is invalid. The message contains the key, the reason and what to write."""


@dataclass(frozen=True)
class Axis:
    """Quantity that varies, over ``values`` (a grid) or sampled between ``low`` and ``high``."""

    name: str
    values: tuple[float, ...] = ()
    low: float = math.nan
    high: float = math.nan

    @property
    def sampled(self) -> bool:
        """True if the values are drawn, False if they are listed."""
        return not self.values


@dataclass(frozen=True)
class Sample:
    """Sampling of all axes with a range: ``method`` (one of `METHODS`), number of ``points`` and ``seed``."""

    method: str = METHODS[0]
    points: int = 64
    seed: int = 1


@dataclass(frozen=True)
class Hardware:
    """Limits from the driver's parameter file, ``model`` of the cable servos, and supply ``voltage`` in V."""

    driver: DrivenBy | None = None
    model: str = ""
    voltage: float | None = None


@dataclass(frozen=True)
class Resolution:
    """Resolution of the scan for edges, of the stored front (``front_gaits``) and of probabilities (``samples``)."""

    scan: ScanResolution = field(default_factory=ScanResolution)
    front_gaits: int = 32
    samples: int = 500
    seed: int = 1


@dataclass(frozen=True)
class Study:
    """Validated description of a study.

    Attributes:
        title: title of the study.
        text: content of the YAML file.
        files: (name, content) of the parameter file of each robot.
        axes: quantities that vary.
        sample: sampling of the axes with a range.
        fixed: values of the quantities that do not vary.
        margin_at_cliff: True if the margin of each point is that at the cliff of its scan.
        hardware: limits of driver and servos.
        compute: requested results, some of `COMPUTABLE`.
        resolution: resolution of the computation.
        scan: margins of the scan.
        block_points: number of points in a block.
    """

    title: str
    text: str
    files: tuple[tuple[str, ParameterFile], ...]
    axes: tuple[Axis, ...]
    sample: Sample
    fixed: Mapping[str, float]
    margin_at_cliff: bool
    hardware: Hardware
    compute: tuple[str, ...]
    resolution: Resolution
    scan: ScanSettings
    block_points: int

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the quantities that vary between points, in the order of the columns of `points`."""
        return (PARAMETER_FILE, *(axis.name for axis in self.axes))

    @property
    def size(self) -> int:
        """Number of points."""
        grids = math.prod(len(axis.values) for axis in self.axes if not axis.sampled)
        sampled = self.sample.points if any(axis.sampled for axis in self.axes) else 1
        return len(self.files) * grids * sampled

    @property
    def blocks(self) -> list[slice]:
        """Slice of the points of each block. The last block may be shorter."""
        return [
            slice(start, min(start + self.block_points, self.size))
            for start in range(0, self.size, self.block_points)
        ]

    @property
    def gaits_per_point(self) -> float:
        """Approximate number of gaits to evaluate for one point.

        Gaits with limits that need a simulated cycle count several times.
        """
        resolution = self.resolution
        cells = resolution.scan.strokes * resolution.scan.frequencies
        limited = bool(self.hardware.model) or bool(set(LIMITS[1:]) & self._named())
        gaits = 0.0
        if {"front", "gaits", "success"} & set(self.compute):
            gaits += _PER_CELL * cells
        if "cliff" in self.compute or self.margin_at_cliff:
            gaits += _PER_MARGIN * len(self.scan.margins())
        gaits *= _LIMITED if limited else 1.0
        if "any_phase" in self.compute:
            gaits += _ANY_PHASE
        return gaits + ("success" in self.compute) * 2.0 * 3.0 * resolution.samples

    def _named(self) -> set[str]:
        return {*self.fixed, *(axis.name for axis in self.axes)}

    def points(self) -> Array:
        """Return the value of each of `varied` at each point, shape (size, len(varied)).

        The parameter files vary slowest and the samples fastest.
        """
        grids = [np.arange(float(len(self.files)))]
        grids += [np.array(axis.values) for axis in self.axes if not axis.sampled]
        ranges = [axis for axis in self.axes if axis.sampled]
        if ranges:
            grids.append(np.arange(float(self.sample.points)))
        mesh = [each.ravel() for each in np.meshgrid(*grids, indexing="ij")]
        columns = {PARAMETER_FILE: mesh[0]}
        names = [axis.name for axis in self.axes if not axis.sampled]
        columns |= dict(zip(names, mesh[1:], strict=False))
        if ranges:
            drawn = _drawn(self.sample, ranges)
            row = mesh[-1].astype(int)
            columns |= {axis.name: drawn[row, k] for k, axis in enumerate(ranges)}
        return np.stack([columns[name] for name in self.varied], axis=1)

    @property
    def identity(self) -> str:
        """Hash of all inputs that determine the result, without the code. Studies with the same hash are the same."""
        content = dataclasses.asdict(dataclasses.replace(self, text="", title=""))
        text = json.dumps(content, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def _drawn(sample: Sample, ranges: Sequence[Axis]) -> Array:
    """Return the sampled values, shape (points, axes).

    Sobol points are scrambled, which keeps them away from the bounds.
    """
    if sample.method == "sobol":
        engine: Any = qmc.Sobol(len(ranges), scramble=True, seed=sample.seed)
        unit = engine.random_base2(math.ceil(math.log2(max(sample.points, 2))))[: sample.points]
    else:
        engine = qmc.LatinHypercube(len(ranges), seed=sample.seed)
        unit = engine.random(sample.points)
    low, high = (np.array([getattr(axis, end) for axis in ranges]) for end in ("low", "high"))
    return low + unit * (high - low)


def load_study(path: str | Path, parameters: str = "") -> Study:
    """Read the file of a study.

    Args:
        path: YAML file. Paths in it are relative to its folder.
        parameters: parameter file of the robot, if the study names none.

    Raises:
        StudyError: The file is invalid. The message begins with the path.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        return parse_study(text, Path(path).parent, parameters)
    except OSError as error:
        raise StudyError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise StudyError(f"{path}: is not a text file") from None
    except InputError as error:
        raise StudyError(f"{path}: {error}") from None


def parse_study(text: str, folder: Path, parameters: str = "") -> Study:
    """Return the `Study` described by the text of its file, see `load_study`."""
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        raise StudyError(
            "is not valid YAML" + (f" at line {mark.line + 1}" if mark else "")
        ) from None
    entries = _mapping("the file", content, _KEYS)
    axes = _axes(entries.get("vary"))
    fixed, at_cliff = _fixed(entries.get("fixed"))
    twice = {axis.name for axis in axes} & set(fixed)
    if at_cliff and any(axis.name == "margin_m" for axis in axes):
        twice.add("margin_m")
    if twice:
        raise StudyError(f"{min(twice)}: stands under vary and under fixed; keep one")
    study = Study(
        title=str(entries.get("title") or "Study"),
        text=text,
        files=_files(entries, folder, parameters),
        axes=axes,
        sample=_sample(entries.get("sample"), axes),
        fixed=fixed,
        margin_at_cliff=at_cliff,
        hardware=_hardware(entries.get("hardware"), folder),
        compute=_compute(entries.get("compute")),
        resolution=_resolution(entries.get("resolution")),
        scan=_scan(entries.get("scan")),
        block_points=1,
    )
    _check(study)
    return dataclasses.replace(
        study, block_points=_block_points(entries.get("block_points"), study)
    )


def _check(study: Study) -> None:
    """Check the conditions that involve several keys."""
    named = {axis.name for axis in study.axes} | set(study.fixed)
    if study.size > MOST_POINTS:
        raise StudyError(
            f"vary: makes {study.size} points, more than {MOST_POINTS}: take fewer values"
        )
    needs_margin = {"front", "gaits", "success"} & set(study.compute)
    if needs_margin and not study.margin_at_cliff and "margin_m" not in named:
        raise StudyError(
            f"compute: {min(needs_margin)} needs a margin: "
            "write fixed: {margin_m: 0.002}, vary it, or write margin_m: cliff"
        )
    if "groove_phase_m" in named and "initial_length" in named:
        raise StudyError(
            "groove_phase_m: it sets initial_length, which is given as well; keep one of them"
        )
    if "spool_radius_m" in named and not study.hardware.model:
        raise StudyError(
            "spool_radius_m: says something only with a servo: "
            "write hardware: {driver: FILE, servo_model: NAME}"
        )
    if not study.axes and len(study.files) == 1:
        raise StudyError("vary: nothing varies: name at least one quantity, or parameter_files")


def _mapping(where: str, content: Any, known: Sequence[str]) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise StudyError(f"{where}: expected a mapping with some of {', '.join(known)}")
    for key in content:
        if key not in known:
            raise StudyError(f"{where}: {_unknown(str(key), known)}")
    return dict(content)


def _unknown(key: str, known: Sequence[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    return f"no such key as {key!r}; " + (
        f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}"
    )


def _number(where: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        hint = " (YAML reads 1e-3 as text: write 1.0e-3)" if isinstance(value, str) else ""
        raise StudyError(f"{where}: {value!r} is not a finite number{hint}")
    return float(value)


def _whole(where: str, value: Any, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise StudyError(f"{where}: {value!r} is not a whole number from {least} to {most}")
    return value


class _Section(dict[str, Any]):
    """Optional part of the file, with validated keys."""

    def __init__(self, where: str, content: Any, known: Sequence[str]) -> None:
        super().__init__({} if content is None else _mapping(where, content, known))
        self._where = where

    def number(self, key: str, default: float) -> float:
        """Return a finite number, or the default if the key is missing."""
        return _number(f"{self._where}: {key}", self.get(key, default))

    def whole(self, key: str, default: int, least: int, most: int) -> int:
        """Return an integer within bounds, or the default if the key is missing."""
        return _whole(f"{self._where}: {key}", self.get(key, default), least, most)


def _axes(content: Any) -> tuple[Axis, ...]:
    rows = _Section("vary", content, tuple(QUANTITY_UNITS))
    return tuple(_axis(name, row) for name, row in rows.items())


def _axis(name: str, row: Any) -> Axis:
    where = f"vary: {name}"
    form = {"values": row} if isinstance(row, list) else row
    if isinstance(form, Mapping) and set(form) == {"range"}:
        axis = Axis(name, (), *_range(where, form["range"]))
    elif isinstance(form, Mapping) and set(form) in ({"values"}, {"from", "to", "count"}):
        axis = Axis(name, _listed(where, form))
    else:
        raise StudyError(
            f"{where}: write a list of values, {{from: A, to: B, count: N}}, or {{range: [A, B]}}"
        )
    if name == "direction" and not (axis.values and set(axis.values) <= {1.0, -1.0}):
        raise StudyError(f"{where}: takes a list of 1 and -1")
    return axis


def _range(where: str, ends: Any) -> tuple[float, float]:
    if not isinstance(ends, list) or len(ends) != 2:
        raise StudyError(f"{where}: range: expected [low, high]")
    low, high = (_number(f"{where}: range", end) for end in ends)
    if not low < high:
        raise StudyError(f"{where}: range: {low:g} is not below {high:g}")
    return low, high


def _listed(where: str, form: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the values of a grid, either listed or evenly spaced between two ends.

    Evenly spaced values are rounded, so that 0.3 is exactly 0.3.
    """
    if "count" in form:
        count = _whole(f"{where}: count", form["count"], 2, 100_000)
        low, high = (_number(f"{where}: {end}", form[end]) for end in ("from", "to"))
        values = [float(f"{value:.12g}") for value in np.linspace(low, high, count)]
    elif isinstance(form["values"], list) and form["values"]:
        values = [_number(where, value) for value in form["values"]]
    else:
        raise StudyError(f"{where}: values: expected a list of numbers")
    if len(set(values)) < len(values):
        raise StudyError(f"{where}: a value stands there twice")
    return tuple(values)


def _fixed(content: Any) -> tuple[dict[str, float], bool]:
    """Return the fixed values, and True if the margin is that at the cliff."""
    rows = _Section("fixed", content, tuple(QUANTITY_UNITS))
    at_cliff = rows.get("margin_m") == CLIFF
    if at_cliff:
        del rows["margin_m"]
    numbers = {name: _number(f"fixed: {name}", value) for name, value in rows.items()}
    if numbers.get("direction", 1.0) not in (1.0, -1.0):
        raise StudyError("fixed: direction is 1 or -1")
    return numbers, at_cliff


def _files(
    content_of: Mapping[str, Any], folder: Path, parameters: str
) -> tuple[tuple[str, ParameterFile], ...]:
    names = content_of.get("parameter_files")
    if sum(map(bool, (names, content_of.get("parameters"), parameters))) > 1:
        raise StudyError(
            "parameters: the robot is given twice; keep one of parameters, parameter_files, --parameters"
        )
    if names is None:
        path = (
            str(folder / str(content_of["parameters"]))
            if content_of.get("parameters")
            else parameters
        )
        return ((Path(path).name if path else "the paper", load_parameter_file(path)),)
    if not isinstance(names, list) or not names:
        raise StudyError("parameter_files: expected a list of files")
    if len(set(map(str, names))) < len(names):
        raise StudyError("parameter_files: a file stands there twice")
    return tuple((str(name), load_parameter_file(folder / str(name))) for name in names)


def _sample(content: Any, axes: Sequence[Axis]) -> Sample:
    needed = any(axis.sampled for axis in axes)
    if needed and content is None:
        raise StudyError(
            "sample: a range needs one: write sample: {method: sobol, points: 64, seed: 1}"
        )
    if not needed and content is not None:
        raise StudyError("sample: nothing under vary has a range to sample")
    plain, rows = Sample(), _Section("sample", content, ("method", "points", "seed"))
    method = rows.get("method", plain.method)
    if method not in METHODS:
        raise StudyError(f"sample: method {method!r} is none of {', '.join(METHODS)}")
    points = rows.whole("points", plain.points, 1, MOST_POINTS)
    return Sample(method, points, rows.whole("seed", plain.seed, 0, 2**32 - 1))


def _hardware(content: Any, folder: Path) -> Hardware:
    if content is None:
        return Hardware()
    rows = _Section("hardware", content, ("driver", "servo_model", "supply_voltage_V"))
    if not rows.get("driver"):
        raise StudyError("hardware: driver is missing: name the driver's parameter file")
    model, voltage = str(rows.get("servo_model") or ""), rows.get("supply_voltage_V")
    servo_model(model)  # raises if the name is unknown
    return Hardware(
        driver=load_driver_file(folder / str(rows["driver"])),
        model=model,
        voltage=None if voltage is None else rows.number("supply_voltage_V", 0.0),
    )


def _compute(content: Any) -> tuple[str, ...]:
    if not isinstance(content, list) or not content:
        raise StudyError(f"compute: expected a list with some of {', '.join(COMPUTABLE)}")
    for name in content:
        if name not in COMPUTABLE:
            raise StudyError(f"compute: {_unknown(str(name), COMPUTABLE)}")
    return tuple(name for name in COMPUTABLE if name in content)


def _resolution(content: Any) -> Resolution:
    plain = Resolution()
    keys = ("strokes", "frequencies", "front_gaits", "samples", "seed")
    rows = _Section("resolution", content, keys)
    return Resolution(
        scan=ScanResolution(
            strokes=rows.whole("strokes", plain.scan.strokes, 3, 10_000),
            frequencies=rows.whole("frequencies", plain.scan.frequencies, 2, 10_000),
        ),
        front_gaits=rows.whole("front_gaits", plain.front_gaits, 3, 10_000),
        samples=rows.whole("samples", plain.samples, 1, 1_000_000),
        seed=rows.whole("seed", plain.seed, 0, 2**32 - 1),
    )


def _scan(content: Any) -> ScanSettings:
    plain, rows = ScanSettings(), _Section("scan", content, ("lowest_m", "highest_m", "step_m"))
    return ScanSettings(
        rows.number("lowest_m", plain.lowest),
        rows.number("highest_m", plain.highest),
        rows.number("step_m", plain.step),
    )


def _block_points(value: Any, study: Study) -> int:
    """Return the points of a block: enough to outweigh the cost of submitting it, and few enough to show progress."""
    if value is not None:
        return _whole("block_points", value, 1, MOST_POINTS)
    by_time = math.ceil(_BLOCK_SECONDS / (_SECONDS_PER_GAIT * max(study.gaits_per_point, 1.0)))
    return max(1, min(by_time, math.ceil(study.size / _FEWEST_BLOCKS)))
