# SPDX-License-Identifier: Apache-2.0
"""Table of many bags in Parquet format. Each bag is read, replayed and compared with the model independently.

The table has a row for each gait of a bag. A bag that cannot be used has a single row with the reason. Until all bags
are read, the rows of each bag are stored in a file of their own, in a folder next to the output. A command that was
killed can then be repeated without reading these bags again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

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
from worm_optimizer.study.engine import LostError, Say, connected, cores, spread
from worm_optimizer.study.store import check_folder, lock
from worm_optimizer.study.study_run import Counts, Workers

READ, FAILED = "read", "failed"
_IDENTITY = b"worm_fleet"  # key of the table's metadata under which `_Fleet.identity` is stored
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
SCHEMA = pa.schema(
    [(name, pa.string()) for name in _TEXTS] + [(name, pa.float64()) for name in _NUMBERS]
)

Row = dict[str, Any]


class UnseenError(RuntimeError):
    """A worker cannot access a bag. The message is the path of the bag."""


def bag_rows(path: str, name: str, parameters: str) -> list[Row]:
    """Return the rows of one bag.

    Args:
        path: bag.
        name: name of the bag in the table.
        parameters: path of a parameter file, or an empty string for the parameters in the bag.

    Raises:
        UnseenError: The bag does not exist on the machine of this worker.
    """
    if not Path(path).exists():
        raise UnseenError(path)
    empty: Row = {**dict.fromkeys(_TEXTS, ""), **dict.fromkeys(_NUMBERS, math.nan), "bag": name}
    notes: list[str] = []
    try:
        gaits = read_recorded_gaits([Path(path)], parameters, notes.append)
    except (InputError, OSError) as error:
        return [{**empty, "state": FAILED, "reason": _one_line(error)}]
    rows = [{**empty, **_row_of(gait)} for gait in gaits]
    used = gaits[0].content.parameters
    healthy, left_out = estimate_bags([Path(path)], used)
    for bag in healthy:
        notes += bag.remarks
        for row in rows:
            for key, estimate in bag.estimates.items():
                known = estimate.identifiable
                row[key] = estimate.value if known else math.nan
                row[f"{key}_low"], row[f"{key}_high"] = estimate.low, estimate.high
    notes += [f"health: {bag.reason}" for bag in left_out]
    for row in rows:
        row["notes"] = "; ".join([*filter(None, [row["notes"]]), *notes])
    return rows


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())


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
    fleet = _fleet(folder, parameters)
    if output.exists():
        return _known(output, fleet.identity)
    with _parts(output) as parts:
        files = [parts / f"{mark}.json" for mark in fleet.marks]
        todo = [k for k, file in enumerate(files) if not file.exists()]
        progress(1.0 - len(todo) / len(files))
        source = str(Path(parameters).resolve()) if parameters else ""
        if todo:
            number = min(workers.number or cores(), len(todo))
            with connected(workers.scheduler, number, say) as client:
                pieces = [(str(fleet.bags[k].resolve()), fleet.names[k], source) for k in todo]
                _read(client, pieces, [files[k] for k in todo], len(files), say, progress)
        rows = [row for file in files for row in json.loads(file.read_text())]
        table = pa.Table.from_pylist(rows, SCHEMA).replace_schema_metadata(
            {_IDENTITY: fleet.identity.encode()}
        )
        part = parts / "table"
        parquet.write_table(table, part)
        part.rename(output)
        shutil.rmtree(parts)
    return _known(output, fleet.identity)


def reopen_fleet(folder: Path, parameters: str, output: Path) -> None:
    """Remove the rows of failed bags, so that `read_fleet` reads these bags again.

    Raises:
        InputError: The parameter file is invalid, or the output contains other bags or cannot be used.
    """
    fleet = _fleet(folder, parameters)
    if output.exists():
        _known(output, fleet.identity)
    with _parts(output) as parts:
        files = [parts / f"{mark}.json" for mark in fleet.marks]
        if output.exists():
            rows = parquet.read_table(output).to_pylist()
            for name, file in zip(fleet.names, files, strict=True):
                file.write_text(json.dumps([row for row in rows if row["bag"] == name]))
            output.unlink()  # its rows are in the files
        for file in files:
            if file.exists() and any(
                row["state"] == FAILED for row in json.loads(file.read_text())
            ):
                file.unlink()


@dataclass(frozen=True)
class _Fleet:
    """Bags, their names in the table, a hash of each (``marks``, see `_mark`), and a hash of all (``identity``)."""

    bags: tuple[Path, ...]
    names: tuple[str, ...]
    marks: tuple[str, ...]
    identity: str


def _fleet(folder: Path, parameters: str) -> _Fleet:
    load_parameter_file(parameters)  # raises if the file is invalid, before any bag is read
    bags = tuple(bags_below(folder))
    marks = tuple(_mark(bag, parameters) for bag in bags)
    whole = hashlib.sha256(" ".join([*marks, identity_of_all()]).encode()).hexdigest()[:24]
    return _Fleet(bags, tuple(name_below(folder, bag) for bag in bags), marks, whole)


def _read(
    client: Any,
    pieces: Sequence[tuple[str, str, str]],
    files: Sequence[Path],
    bags: int,
    say: Say,
    progress: Callable[[float], None],
) -> None:
    done = bags - len(pieces)
    try:
        for place, rows in spread(client, bag_rows, pieces, say):
            part = files[place].with_suffix(".part")
            part.write_text(json.dumps(rows), encoding="utf-8")
            part.rename(files[place])
            done += 1
            progress(done / bags)
    except UnseenError as error:
        raise InputError(
            f"a worker cannot access {error}: use a folder that all workers can access, or leave --scheduler out"
        ) from None
    except (LostError, OSError) as error:
        raise type(error)(
            f"{error}; {done} of {bags} bags are read: repeat the command to continue"
        ) from None


def _mark(bag: Path, parameters: str) -> str:
    """Return a hash of the path and files of a bag, the parameter file, and the code."""
    content = Path(parameters).read_text() if parameters else ""
    text = [str(bag.resolve()), identity_of_all(), content, mark_of(bag)]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()[:24]


def _known(output: Path, whole: str) -> Counts:
    """Return the counts of bags in a finished table; ``whole`` is the hash of the expected fleet.

    Raises:
        InputError: The table cannot be read, contains other bags, or was made by another version of the code.
    """
    try:
        table = parquet.read_table(output, columns=["bag", "state"])
    except (OSError, pa.ArrowException):
        table = None
    if table is None or (table.schema.metadata or {}).get(_IDENTITY) != whole.encode():
        raise InputError(
            f"{output}: exists already and contains other bags, or was read by another version; choose another name, "
            "nothing is overwritten"
        )
    states = dict(zip(table["bag"].to_pylist(), table["state"].to_pylist(), strict=True))
    return Counts(len(states), len(states), sum(state == FAILED for state in states.values()))


@contextlib.contextmanager
def _parts(output: Path) -> Iterator[Path]:
    """Create the folder of the files in which the rows of each bag are stored, and lock it for this process."""
    check_folder(output)
    parts = output.with_name(f"{output.name}.part")
    parts.mkdir(exist_ok=True)
    with (parts / ".lock").open("w") as file:
        lock(file, output)
        yield parts
