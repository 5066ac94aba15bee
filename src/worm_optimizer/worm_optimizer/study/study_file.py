# SPDX-License-Identifier: Apache-2.0
"""Reader of the YAML files of studies. docs/studies.md lists the keys.

Each value is checked when the file is read. Values that exclude each other at a point, such as a groove phase beyond
half a pitch, are detected when the point is computed (`point.content_of`).
"""

from __future__ import annotations

import itertools
import reprlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from numpy import linspace

from worm_model.errors import InputError
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_msgs.settings_file import OneOf, key, settings_of
from worm_msgs.yaml_file import SettingsFileError, parse_yaml
from worm_optimizer.evaluation.servo_limits import load_driver_file, servo_model
from worm_optimizer.search.search_settings import ScanSettings, Waveform
from worm_optimizer.study import plan
from worm_optimizer.study.plan import MOST_POINTS, QUANTITIES, SHAPE_BOUNDS, Sample

CLIFF = "cliff"  # value of margin_m that selects the last margin before the cliff of the point's own scan
_MOST_VALUES = 100_000  # largest number of values of an axis
_RESOLUTION, _SCAN = plan.Resolution(), ScanSettings()

Quantity = Annotated[str, OneOf(tuple(QUANTITIES))]


@dataclass(frozen=True)
class _HardwareFile:
    driver: str
    servo_model: str = ""
    supply_voltage: Annotated[float | None, key("supply_voltage_V", gt=0.0)] = None


@dataclass(frozen=True, kw_only=True)
class StudyFile:
    """Content of a study's file. The values of `vary` and `fixed` are checked after reading."""

    title: str = "Study"
    parameter_files: Annotated[tuple[str, ...] | None, key(min_length=1)] = None
    vary: Mapping[Quantity, Any] = field(default_factory=dict)
    sample: Sample | None = None
    fixed: Mapping[Quantity, Any] = field(default_factory=dict)
    hardware: _HardwareFile | None = None
    compute: Annotated[tuple[Annotated[str, OneOf(plan.COMPUTABLE)], ...], key(min_length=1)]
    resolution: plan.Resolution = _RESOLUTION
    scan: ScanSettings = _SCAN
    waveform: Annotated[str, OneOf(tuple(kind.value for kind in Waveform))] = (
        Waveform.SINUSOID.value
    )


class StudyError(InputError):
    """The description of a study is invalid. The message contains the key and the reason."""


def load_study(path: str | Path, parameters: str = "") -> plan.Study:
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


def parse_study(text: str, folder: Path, parameters: str = "") -> plan.Study:
    """Return the study that a text describes; see `load_study`. Paths in it are relative to ``folder``."""
    try:
        content = parse_yaml(text)
        if isinstance(content, Mapping):  # a key without a value means its default
            content = {name: value for name, value in content.items() if value is not None}
        file = settings_of(content, StudyFile)
    except SettingsFileError as error:
        raise StudyError(str(error)) from None
    axes = tuple(_axis(name, row) for name, row in file.vary.items())
    at_cliff = file.fixed.get("margin_m") == CLIFF
    twice = {axis.name for axis in axes} & set(file.fixed)
    if twice:
        raise StudyError(f"{min(twice)}: is both under vary and under fixed; keep one")
    fixed = {
        name: _quantity(f"fixed: {name}", name, value)
        for name, value in file.fixed.items()
        if not (at_cliff and name == "margin_m")
    }
    study = plan.Study(
        title=file.title,
        text=text,
        files=_files(file, folder, parameters),
        axes=axes,
        sample=_sample(file.sample, axes),
        fixed=fixed,
        margin_at_cliff=at_cliff,
        hardware=_hardware(file.hardware, folder),
        compute=tuple(name for name in plan.COMPUTABLE if name in file.compute),
        resolution=file.resolution,
        scan=file.scan,
        waveform=Waveform(file.waveform),
    )
    _check(study)
    return study


def _check(study: plan.Study) -> None:
    """Check the conditions that involve several keys."""
    named = {axis.name for axis in study.axes} | set(study.fixed)
    shaped = study.waveform is Waveform.SHAPED
    of_shapes = sorted(named & set(itertools.chain(*SHAPE_BOUNDS)))
    need_margin = sorted({"front", "gaits", "success"} & set(study.compute))
    for wrong, message in (
        (
            study.size > MOST_POINTS,
            f"vary: results in {study.size} points, more than {MOST_POINTS}: use fewer values",
        ),
        (
            need_margin and not study.margin_at_cliff and "margin_m" not in named,
            f"compute: {', '.join(need_margin)}: needs a margin: "
            'write "fixed: {margin_m: 0.002}" or "fixed: {margin_m: cliff}", or put margin_m under vary',
        ),
        (
            of_shapes and not shaped,
            f"{', '.join(of_shapes)}: has an effect only with waveform: shaped",
        ),
        (
            shaped and "any_phase" in study.compute,
            "compute: any_phase is not possible with waveform: shaped; remove one of the two",
        ),
        (
            {"groove_phase_m", "initial_length"} <= named,
            "groove_phase_m: sets initial_length, but the study has initial_length, too; keep one of them",
        ),
        (
            "spool_radius_m" in named and not study.hardware.model,
            "spool_radius_m: has an effect only with a servo: "
            "write hardware: {driver: FILE, servo_model: NAME}",
        ),
        (
            not study.dimensions,
            "vary: nothing varies: name at least one quantity, or parameter_files",
        ),
    ):
        if wrong:
            raise StudyError(message)


def _quantity(where: str, name: str, value: Any) -> float:
    """Return the value of a quantity. Raises `StudyError` if it is not admissible."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and abs(value) <= sys.float_info.max):
        hint = " (YAML reads 1e-3 as text: write 1.0e-3)" if isinstance(value, str) else ""
        raise StudyError(f"{where}: {reprlib.repr(value)} is not a finite number{hint}")
    number, quantity = float(value), QUANTITIES[name]
    if name == "direction" and number not in (1.0, -1.0):
        raise StudyError(f"{where}: {number:g} is neither 1 nor -1")
    if not quantity.low <= number <= quantity.high:
        raise StudyError(
            f"{where}: {number:g} {quantity.unit} is outside {quantity.low:g} to {quantity.high:g} "
            f"{quantity.unit}; is it in another unit?"
        )
    return number


def _axis(name: str, row: Any) -> plan.Axis:
    where = f"vary: {name}"
    if isinstance(row, Mapping) and set(row) == {"range"}:
        if name == "direction":
            raise StudyError(f"{where}: expected a list of 1 and -1")
        ends = row["range"]
        if not isinstance(ends, list) or len(ends) != 2:
            raise StudyError(f"{where}: range: expected [low, high]")
        return plan.Axis(name, (), *_ends(f"{where}: range", name, *ends))
    if isinstance(row, Mapping) and set(row) == {"from", "to", "count"}:
        return plan.Axis(name, _evenly_spaced(where, name, row))
    if isinstance(row, list) and row:
        values = tuple(_quantity(where, name, value) for value in row)
        if len(set(values)) < len(values):
            raise StudyError(f"{where}: contains a value twice")
        return plan.Axis(name, values)
    raise StudyError(
        f"{where}: write a list of values, {{from: A, to: B, count: N}}, or {{range: [A, B]}}"
    )


def _evenly_spaced(where: str, name: str, row: Mapping[str, Any]) -> tuple[float, ...]:
    """Return evenly spaced values, rounded to 12 digits, which removes errors of the floating-point arithmetic."""
    count = row["count"]
    if isinstance(count, bool) or not isinstance(count, int) or not 2 <= count <= _MOST_VALUES:
        raise StudyError(
            f"{where}: count: {count!r} is not a whole number from 2 to {_MOST_VALUES}"
        )
    low, high = _ends(where, name, row["from"], row["to"])
    return tuple(float(f"{value:.12g}") for value in linspace(low, high, count))


def _ends(where: str, name: str, low: Any, high: Any) -> tuple[float, float]:
    ends = _quantity(where, name, low), _quantity(where, name, high)
    if not ends[0] < ends[1]:
        raise StudyError(f"{where}: {ends[0]:g} is not below {ends[1]:g}")
    return ends


def _files(file: StudyFile, folder: Path, parameters: str) -> tuple[tuple[str, ParameterFile], ...]:
    names = file.parameter_files
    if names is None:
        return (
            (Path(parameters).name if parameters else "the paper", load_parameter_file(parameters)),
        )
    if parameters:
        raise StudyError("parameter_files: names the robots already; leave --parameters out")
    if len(set(names)) < len(names):
        raise StudyError("parameter_files: contains a file twice")
    return tuple((name, load_parameter_file(folder / name)) for name in names)


def _sample(content: Sample | None, axes: Sequence[plan.Axis]) -> Sample:
    needed = any(axis.sampled for axis in axes)
    if needed and content is None:
        raise StudyError(
            "sample: is missing, but a quantity has a range: write sample: {points: 64, seed: 1}"
        )
    if not needed and content is not None:
        raise StudyError("sample: nothing under vary has a range to sample")
    return content or Sample()


def _hardware(content: _HardwareFile | None, folder: Path) -> plan.Hardware:
    if content is None:
        return plan.Hardware()
    servo_model(content.servo_model)  # raises if the name is unknown
    driver = load_driver_file(folder / content.driver)
    return plan.Hardware(driver, content.servo_model, content.supply_voltage)
