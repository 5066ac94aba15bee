# SPDX-License-Identifier: Apache-2.0
"""YAML files of studies: reading, and writing with all values inside, so that the text alone repeats the study.

docs/studies.md lists the keys. All values are checked here, before the computation starts.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from numpy import linspace

from worm_model.errors import InputError
from worm_model.parameters import (
    ParameterFile,
    format_parameter_file,
    load_parameter_file,
    parse_parameter_file,
)
from worm_optimizer.evaluation.servo_limits import DrivenBy, load_driver_file, servo_model
from worm_optimizer.search.exact import Resolution as ScanResolution
from worm_optimizer.search.search_settings import ScanSettings
from worm_optimizer.study.plan import (
    COMPUTABLE,
    EXTENDABLE,
    METHODS,
    SALTELLI,
    Axis,
    Hardware,
    Resolution,
    Sample,
    Study,
)
from worm_optimizer.study.quantities import QUANTITIES

CLIFF = "cliff"  # written instead of a margin: the margin at the cliff of the point's own scan
MOST_POINTS = 10_000_000
KEYS = (
    *("title", "parameters", "parameter_files", "vary", "sample", "fixed", "hardware"),
    *("compute", "resolution", "scan", "block_points"),
)
_HARDWARE_KEYS = ("driver", "servo_model", "supply_voltage_V")


class StudyError(InputError):
    """The description of a study is invalid. The message contains the key, the reason and what to write."""


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
    entries = _mapping("the file", content, KEYS)
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
    points = entries.get("block_points", study.default_block_points())
    return dataclasses.replace(study, block_points=_whole("block_points", points, 1, MOST_POINTS))


def format_study(study: Study) -> str:
    """Return the text of a file that describes the same study without any other file."""
    margin: dict[str, Any] = {"margin_m": CLIFF} if study.margin_at_cliff else {}
    resolution, scan, driver = study.resolution, study.scan, study.hardware.driver
    content: dict[str, Any] = {
        "title": study.title,
        "parameter_files": {
            name: yaml.safe_load(format_parameter_file(file)) for name, file in study.files
        },
        "vary": {
            axis.name: {"range": [axis.low, axis.high]} if axis.sampled else list(axis.values)
            for axis in study.axes
        },
        "fixed": {**study.fixed, **margin},
        "compute": list(study.compute),
        "resolution": {
            **dataclasses.asdict(resolution.scan),
            **{key: getattr(resolution, key) for key in ("front_gaits", "samples", "seed")},
        },
        "scan": {"lowest_m": scan.lowest, "highest_m": scan.highest, "step_m": scan.step},
        "block_points": study.block_points,
    }
    if study.ranges:
        content["sample"] = dataclasses.asdict(study.sample)
    if driver is not None:
        values = {**dataclasses.asdict(driver), "spool_radii": list(driver.spool_radii)}
        content["hardware"] = {"driver": values, "servo_model": study.hardware.model}
        if study.hardware.voltage is not None:
            content["hardware"]["supply_voltage_V"] = study.hardware.voltage
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def identity_of(study: Study) -> str:
    """Return a hash of all inputs that determine the results, without the code. Title and block size do not count."""
    plain = dataclasses.replace(study, title="Study", block_points=1)
    content = json.dumps(yaml.safe_load(format_study(plain)), sort_keys=True, default=str)
    return hashlib.sha256(content.encode()).hexdigest()[:24]


def extends(study: Study, stored: Study) -> bool:
    """Return True if a study has the points of a stored one and more samples of the same sequence."""
    alike = dataclasses.replace(
        study, sample=dataclasses.replace(study.sample, points=stored.sample.points)
    )
    return (
        bool(study.ranges)
        and study.sample.method in EXTENDABLE
        and study.sample.points > stored.sample.points
        and identity_of(alike) == identity_of(stored)
    )


def _check(study: Study) -> None:
    """Check the conditions that involve several keys."""
    named = {axis.name for axis in study.axes} | set(study.fixed)
    if study.size > MOST_POINTS:
        raise StudyError(
            f"vary: makes {study.size} points, more than {MOST_POINTS}: use fewer values"
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
            "spool_radius_m: has an effect only with a servo: "
            "write hardware: {driver: FILE, servo_model: NAME}"
        )
    if not study.dimensions:
        raise StudyError("vary: nothing varies: name at least one quantity, or parameter_files")
    if study.ranges and study.sample.method == SALTELLI:
        if len(study.dimensions) > 1:
            raise StudyError(
                "sample: saltelli needs ranges only: remove the lists of values and further parameter files"
            )
        if study.sample.points & (study.sample.points - 1):
            raise StudyError(
                f"sample: points: {study.sample.points} is not a power of two, which saltelli needs"
            )


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


def _quantity(where: str, name: str, value: Any) -> float:
    """Return an admissible value of a quantity."""
    number, quantity = _number(where, value), QUANTITIES[name]
    if name == "direction" and number not in (1.0, -1.0):
        raise StudyError(f"{where}: {number:g} is neither 1 nor -1")
    if not quantity.low <= number <= quantity.high:
        raise StudyError(
            f"{where}: {number:g} {quantity.unit} is outside {quantity.low:g} to {quantity.high:g} "
            f"{quantity.unit}; is it in another unit?"
        )
    return number


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
    rows = _Section("vary", content, tuple(QUANTITIES))
    return tuple(_axis(name, row) for name, row in rows.items())


def _axis(name: str, row: Any) -> Axis:
    where = f"vary: {name}"
    form = {"values": row} if isinstance(row, list) else row
    if isinstance(form, Mapping) and set(form) == {"range"}:
        if name == "direction":
            raise StudyError(f"{where}: expected a list of 1 and -1")
        return Axis(name, (), *_range(where, name, form["range"]))
    if isinstance(form, Mapping) and set(form) in ({"values"}, {"from", "to", "count"}):
        return Axis(name, _listed(where, name, form))
    raise StudyError(
        f"{where}: write a list of values, {{from: A, to: B, count: N}}, or {{range: [A, B]}}"
    )


def _range(where: str, name: str, ends: Any) -> tuple[float, float]:
    if not isinstance(ends, list) or len(ends) != 2:
        raise StudyError(f"{where}: range: expected [low, high]")
    low, high = (_quantity(f"{where}: range", name, end) for end in ends)
    if not low < high:
        raise StudyError(f"{where}: range: {low:g} is not below {high:g}")
    return low, high


def _listed(where: str, name: str, form: Mapping[str, Any]) -> tuple[float, ...]:
    """Return the values of a grid, either listed or evenly spaced between two ends.

    Evenly spaced values are rounded, so that 0.3 is exactly 0.3.
    """
    if "count" in form:
        count = _whole(f"{where}: count", form["count"], 2, 100_000)
        low, high = (_quantity(f"{where}: {end}", name, form[end]) for end in ("from", "to"))
        values = [float(f"{value:.12g}") for value in linspace(low, high, count)]
    elif isinstance(form["values"], list) and form["values"]:
        values = [_quantity(where, name, value) for value in form["values"]]
    else:
        raise StudyError(f"{where}: values: expected a list of numbers")
    if len(set(values)) < len(values):
        raise StudyError(f"{where}: contains a value twice")
    return tuple(values)


def _fixed(content: Any) -> tuple[dict[str, float], bool]:
    """Return the fixed values, and True if the margin is that at the cliff."""
    rows = _Section("fixed", content, tuple(QUANTITIES))
    at_cliff = rows.get("margin_m") == CLIFF
    if at_cliff:
        del rows["margin_m"]
    return {name: _quantity(f"fixed: {name}", name, row) for name, row in rows.items()}, at_cliff


def _files(
    entries: Mapping[str, Any], folder: Path, parameters: str
) -> tuple[tuple[str, ParameterFile], ...]:
    names, single = entries.get("parameter_files"), entries.get("parameters")
    if sum(map(bool, (names, single, parameters))) > 1:
        raise StudyError(
            "parameters: the robot is given twice; keep one of parameters, parameter_files, --parameters"
        )
    if names is None:
        path = str(folder / str(single)) if single else parameters
        return ((Path(path).name if path else "the paper", load_parameter_file(path)),)
    if isinstance(names, Mapping) and names:
        return tuple((str(name), parse_parameter_file(content)) for name, content in names.items())
    if not isinstance(names, list) or not names:
        raise StudyError(
            "parameter_files: expected a list of files, or a mapping of their contents"
        )
    if len(set(map(str, names))) < len(names):
        raise StudyError("parameter_files: contains a file twice")
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
    rows = _Section("hardware", content, _HARDWARE_KEYS)
    if not rows.get("driver"):
        raise StudyError("hardware: driver is missing: name the driver's parameter file")
    model, voltage = str(rows.get("servo_model") or ""), rows.get("supply_voltage_V")
    servo_model(model)  # raises if the name is unknown
    return Hardware(
        driver=_driver(rows["driver"], folder),
        model=model,
        voltage=None if voltage is None else rows.number("supply_voltage_V", 0.0),
    )


def _driver(content: Any, folder: Path) -> DrivenBy:
    """Return the limits of a driver's parameter file, or those that `format_study` wrote."""
    if not isinstance(content, Mapping):
        return load_driver_file(folder / str(content))
    names = tuple(row.name for row in dataclasses.fields(DrivenBy))
    values = _mapping("hardware: driver", content, names)
    try:
        radii = tuple(map(float, values.pop("spool_radii")))
        return DrivenBy(radii, **{name: float(value) for name, value in values.items()})
    except (KeyError, TypeError, ValueError):
        raise StudyError(f"hardware: driver: expected numbers for {', '.join(names)}") from None


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
