# SPDX-License-Identifier: Apache-2.0
"""Tables of gaits as CSV. Each row is a gait. A column named after a parameter contains its value for each gait."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.errors import InputError
from worm_model.parameters import FORM, KEYS, Parameters
from worm_model.simulation.batch import GaitTable, check_bodies, evaluate_gaits
from worm_msgs.gait import GAIT_COLUMNS, GAIT_DEFAULTS, GaitError, Profile

REQUIRED = tuple(column for name, column in GAIT_COLUMNS.items() if name not in GAIT_DEFAULTS)
OPTIONAL = ("L0_m", *(GAIT_COLUMNS[name] for name in GAIT_DEFAULTS))
RESULTS = ("speed_m_s", "power_W", "grooves_per_cycle", "switches_5_cycles", "groove_phase_m")

Columns = dict[str, NDArray[np.float64]]


def read_gaits(path: str | Path) -> Columns:
    """Return the columns of a table of gaits.

    Raises:
        InputError: The file cannot be read or contains no gait, a column is missing, unknown or present twice, or a
            value is not a finite number (the message then names the line and the column).
    """
    try:
        with Path(path).open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            header = [name.strip() for name in reader.fieldnames or []]
            _check_header(path, header)
            rows = [(reader.line_num, list(row.values())) for row in reader]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{path}: is not a CSV table") from None
    if not rows:
        raise InputError(f"{path}: contains no gait; add a line below its header")
    columns: Columns = {name: np.empty(len(rows)) for name in header}
    for k, (line, row) in enumerate(rows):
        if len(row) != len(header):
            raise InputError(f"{path}, line {line}: {len(row)} values for {len(header)} columns")
        for name, text in zip(header, row, strict=True):
            columns[name][k] = _number(path, line, name, text)
    return columns


def _check_header(path: str | Path, header: list[str]) -> None:
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise InputError(f"{path}: no column {missing[0]}; needed: {', '.join(REQUIRED)}")
    for name in header:
        if name not in (*REQUIRED, *OPTIONAL, *RESULTS, *KEYS):
            raise InputError(
                f"{path}: unknown column {name!r}; known: {', '.join((*REQUIRED, *OPTIONAL))} "
                f"and the keys of a parameter file, except {FORM}"
            )
    if len(set(header)) != len(header) or {"L0_m", "initial_length"} <= set(header):
        raise InputError(f"{path}: a column appears twice (L0_m and initial_length are the same)")


def _number(path: str | Path, line: int, name: str, text: str | None) -> float:
    if name == "profile":
        by_name: Any = Profile
        try:
            return float(by_name((text or "").strip()))
        except GaitError as error:
            raise InputError(f"{path}, line {line}, column {name}: {error}") from None
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}, line {line}, column {name}: {text!r} is not a finite number")
    return value


def evaluate_table(
    columns: Columns, parameters: Parameters, progress: Callable[[float], None] | None = None
) -> tuple[Columns, GaitTable]:
    """Return (values of the overridden parameters by key, results), with one value per row of the table.

    Raises the errors of `batch.evaluate_gaits`.
    """
    overrides = {key: columns[key] for key in KEYS if key in columns}
    if "L0_m" in columns:
        overrides["initial_length"] = columns["L0_m"]
    reach = columns["stroke_m"] + columns.get("pretension_m", 0.0)
    check_bodies(reach, overrides.get("initial_length", parameters.initial_length))
    gaits: dict[str, Any] = {
        name: columns[column] for name, column in GAIT_COLUMNS.items() if column in columns
    }
    table = evaluate_gaits(**gaits, parameters=parameters, overrides=overrides, progress=progress)
    return overrides, table


def write_table(path: Path, table: GaitTable, overrides: Columns, parameters: Parameters) -> None:
    """Write a new file with a row for each gait: stroke, frequency, margin, L0, direction, results, further columns.

    The results include the groove phase. The further columns are the other fields of the gait and the other overridden
    parameters. Raises `FileExistsError` if the file exists.
    """
    rows = table.speed.size
    length = np.broadcast_to(overrides.get("initial_length", parameters.initial_length), (rows,))
    further = {key: values for key, values in overrides.items() if key != "initial_length"}
    gaits: dict[str, tuple[Any, str]] = {
        GAIT_COLUMNS[name]: (values, ".0f" if name == "direction" else ".6f")
        for name, values in table.gait.items()
    }
    gaits["profile"] = ([str(Profile(value)) for value in table.gait["profile"]], "")
    columns = {
        **{name: gaits.pop(name) for name in (*REQUIRED, "margin_m")},
        "L0_m": (length, ".6f"),
        "direction": gaits.pop("direction"),
        "speed_m_s": (table.speed, ".12e"),
        "power_W": (table.power, ".9e"),
        "grooves_per_cycle": (table.grooves_per_cycle, ".6f"),
        "switches_5_cycles": (table.switches, "d"),
        "groove_phase_m": (table.groove_phase, ".9f"),
        **gaits,
        **{key: (values, ".9g") for key, values in further.items()},
    }
    with path.open("x", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for k in range(rows):
            writer.writerow([format(values[k], form) for values, form in columns.values()])
