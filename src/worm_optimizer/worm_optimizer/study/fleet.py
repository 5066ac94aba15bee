# SPDX-License-Identifier: Apache-2.0
"""Table of many bags in Parquet format: each bag is read, replayed and compared with the model independently.

The table has a row for each gait of a bag. A bag that cannot be used has a single row with the reason.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet

from worm_model.bags.formats.finding import bags_below, mark_of, name_below
from worm_model.errors import InputError
from worm_model.identification.drift import ADVICE
from worm_model.identification.drift_estimates import estimate_bags
from worm_model.parameters import load_parameter_file
from worm_optimizer.code_version import identity_of_all
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.report.recordings import read_recorded_gaits
from worm_optimizer.study.blocks import (
    ITEMS,
    Block,
    Counts,
    Say,
    Task,
    Workers,
    complete,
    keys_of,
    new_output,
)

READ, FAILED = "read", "failed"
_IDENTITY = b"worm_fleet"  # key of the table's metadata that contains the hash of its bags
_BAG = "mark"  # entry of a block with the hash of its bag
_HEALTH = tuple(f"{key}{part}" for key in ADVICE for part in ("", "_low", "_high"))
_TEXTS = ("bag", "gait", "state", "reason", "start", "parameters", "notes")
_NUMBERS = (
    *("stroke_m", "frequency_Hz", "direction", "margin_m", "cycles", "groove_phase_m"),
    *("speed_m_s", "power_W", "cost_of_transport"),
    *("expected_speed_m_s", "expected_power_W", "expected_cost_of_transport"),
    *("twin_speed_m_s", "twin_power_W"),
    *("x1_rmse_m", "length_rmse_m", "power_rmse_W", "energy_error", "events"),
    *_HEALTH,
)
_SCHEMA = pa.schema(
    [(name, pa.string()) for name in _TEXTS] + [(name, pa.float64()) for name in _NUMBERS]
)

Row = dict[str, Any]


def read_fleet(
    folder: Path,
    parameters: str,
    output: Path,
    workers: Workers,
    say: Say,
    progress: Callable[[float], None],
) -> Counts:
    """Read all bags below ``folder`` into the table ``output``, and return the numbers of all and of failed bags.

    If the process or the cluster fails, the rows read so far remain, and calling this again reads the other bags.

    Args:
        folder: folder of the bags, which all workers must be able to access.
        parameters: parameter file. An empty string selects the parameters in each bag, or the paper's values for a
            bag without parameters.
        output: Parquet file.
        workers: workers to use.
        say: function that is called with each message.
        progress: function that is called with the finished share of the bags, 0 to 1.

    Raises:
        InputError: The parameter file is invalid, the output contains other bags or cannot be used, the cluster cannot
            be used, or a worker cannot access a bag.
        LostError: The cluster was lost.
        OSError: The rows cannot be written.
    """
    load_parameter_file(parameters)  # raises if the file is invalid, before any bag is read
    source = str(Path(parameters).resolve()) if parameters else ""
    bags = np.array(
        [
            (_mark(bag, parameters), str(bag.resolve()), name_below(folder, bag))
            for bag in bags_below(folder)
        ]
    )
    if not output.exists():
        task = Task(_bag_block, source, bags, 1, identity_of_all())
        found = {
            keys_of(block[ITEMS])[0]: block
            for block in complete(task, output, workers, say, progress)
        }
        in_order = [found[key] for key in keys_of(bags)]
        columns = [np.concatenate([block[name] for block in in_order]) for name in _SCHEMA.names]
        table = pa.table(columns, _SCHEMA).replace_schema_metadata({_IDENTITY: _hash(bags)})
        with new_output(output) as part:
            parquet.write_table(table, part)
    return _counts(output, _hash(bags))


def _mark(bag: Path, parameters: str) -> str:
    """Return a hash of the files of a bag and of the parameter file."""
    content = Path(parameters).read_text() if parameters else ""
    return hashlib.sha256(f"{content}\n{mark_of(bag)}".encode()).hexdigest()[:24]


def _hash(bags: np.ndarray) -> bytes:
    """Return a hash of all bags and of the code."""
    content = [*bags.ravel().tolist(), identity_of_all()]
    return hashlib.sha256("\n".join(content).encode()).hexdigest()[:24].encode()


def _counts(output: Path, identity: bytes) -> Counts:
    """Return the counts of bags in a finished table; ``identity`` is the hash of the expected bags."""
    try:
        table = parquet.read_table(output, columns=["bag", "state"])
    except (OSError, pa.ArrowException):
        table = None
    if table is None or (table.schema.metadata or {}).get(_IDENTITY) != identity:
        raise InputError(
            f"{output}: exists already and contains other bags, or was read by another version; choose another name, "
            "nothing is overwritten"
        )
    states = dict(zip(table["bag"].to_pylist(), table["state"].to_pylist(), strict=True))
    return Counts(len(states), len(states), sum(state == FAILED for state in states.values()))


def _bag_block(parameters: str, bags: np.ndarray) -> Block:
    """Return the columns of the table for one bag.

    Args:
        parameters: path of a parameter file, or an empty string for the parameters in the bag.
        bags: mark, path and name of the bag, shape (1, 3).
    """
    _, path, name = bags[0].tolist()
    if not Path(path).exists():
        raise InputError(
            f"a worker cannot access {path}: use a folder that all workers can access, or leave --scheduler out"
        )
    rows = _rows(Path(path), name, parameters)
    return {key: np.array([row[key] for row in rows]) for key in _SCHEMA.names}


def _rows(bag: Path, name: str, parameters: str) -> list[Row]:
    empty: Row = {**dict.fromkeys(_TEXTS, ""), **dict.fromkeys(_NUMBERS, math.nan), "bag": name}
    notes: list[str] = []
    try:
        gaits = read_recorded_gaits([bag], parameters, notes.append)
    except (InputError, OSError) as error:
        return [{**empty, "state": FAILED, "reason": " ".join(str(error).split())}]
    rows = [{**empty, **_row_of(gait)} for gait in gaits]
    healthy, left_out = estimate_bags([bag], gaits[0].content.parameters)
    for estimated in healthy:
        notes += estimated.remarks
        for row in rows:
            for key, estimate in estimated.estimates.items():
                row[key] = estimate.value if estimate.identifiable else math.nan
                row[f"{key}_low"], row[f"{key}_high"] = estimate.low, estimate.high
    notes += [f"health: {each.reason}" for each in left_out]
    for row in rows:
        row["notes"] = "; ".join([*filter(None, [row["notes"]]), *notes])
    return rows


def _row_of(gait: RecordedGait) -> Row:
    """Return one gait of a bag as a row, in SI units."""
    played, nominal = gait.gait, gait.expected.nominal
    residuals = gait.judged.residuals
    return {
        "gait": gait.name,
        "state": READ,
        "start": datetime.fromtimestamp(gait.played.onset * 1e-9, UTC).isoformat(),
        "parameters": gait.parameter_source,
        "notes": "; ".join(filter(None, [gait.early_end, *gait.missing])),
        "stroke_m": played.stroke,
        "frequency_Hz": played.frequency,
        "direction": float(played.direction),
        "margin_m": played.margin,
        "cycles": float(gait.played.cycles),
        "groove_phase_m": nominal.groove_phase,
        "speed_m_s": gait.measured.speed.value,
        "power_W": gait.measured.power.value,
        "cost_of_transport": gait.measured.cost_of_transport.value,
        "expected_speed_m_s": gait.expected.bands.speed.value,
        "expected_power_W": gait.expected.bands.power.value,
        "expected_cost_of_transport": gait.expected.bands.cost_of_transport.value,
        "twin_speed_m_s": gait.twin.speed.value,
        "twin_power_W": gait.twin.power.value,
        "x1_rmse_m": residuals.x1_rmse,
        "length_rmse_m": residuals.length_rmse,
        "power_rmse_W": residuals.power_rmse,
        "energy_error": gait.judged.energy_error,
        "events": float(len(gait.events)),
    }
