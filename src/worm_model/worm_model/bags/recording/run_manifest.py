# SPDX-License-Identifier: Apache-2.0
"""Data of a run that a bag stores in addition to the messages: parameters, conditions, seed, versions, notes."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import yaml

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.stored_file import AttachedFile
from worm_model.bags.opening import Bag
from worm_model.bags.recording.recorder import Manifest
from worm_model.checksum import versions_of
from worm_model.errors import printable
from worm_model.loads import content_under
from worm_model.parameters import (
    ParameterError,
    ParameterFile,
    load_parameter_file,
    parse_parameter_file,
)
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions

RUN_RECORD = "worm_run"
HOST = "host"  # key of the computer's name
PARAMETER_ATTACHMENT = "parameters.yaml"
VERSIONED = (
    "worm_driver",
    "worm_model",
    "worm_optimizer",
    "worm_msgs",
    "rclpy",
    "mcap",
    "dynamixel-sdk",
    "numpy",
)


class ManifestError(BagError):
    """Note or parameter file that cannot be used."""


def run_manifest(
    parameter_file: Path | None,
    seed: int | None,
    notes: Sequence[str],
    command: Sequence[str],
    now_ns: int,
    conditions: Conditions = LEVEL,
) -> Manifest:
    """Return the manifest of a run that begins now.

    Args:
        parameter_file: file that the bag stores completely, with its hash; None: the run uses the paper's values.
        seed: seed of the run's random numbers; None: there is none.
        notes: further entries as ``key=value``.
        command: the command line of the recorder.
        now_ns: the time, ns since the epoch.
        conditions: conditions in the pipe; those that are not zero are stored.
    """
    attachments: tuple[AttachedFile, ...] = ()
    record = {
        "recorded_at": datetime.fromtimestamp(now_ns / 1e9, tz=UTC).isoformat(timespec="seconds"),
        "command": printable(" ".join([Path(command[0]).name, *command[1:]])),
        HOST: platform.node(),
        "seed": "" if seed is None else str(seed),
        "parameter_file": "",
        "parameter_sha256": "",
        **_stored(conditions),
        "version.ros_distro": os.environ.get("ROS_DISTRO", ""),
        **{f"version.{name}": text for name, text in versions_of(VERSIONED).items()},
        **_notes(notes),
    }
    if parameter_file is not None:
        data = _read(parameter_file)
        attachments = (AttachedFile(PARAMETER_ATTACHMENT, "application/yaml", data),)
        record["parameter_file"] = printable(str(parameter_file))
        record["parameter_sha256"] = hashlib.sha256(data).hexdigest()
    return Manifest({RUN_RECORD: record}, attachments)


def _stored(conditions: Conditions) -> Mapping[str, str]:
    values = dataclasses.asdict(conditions)
    return {name: repr(value) for name, value in values.items() if value}


def recorded_conditions(bag: Bag) -> Conditions:
    """Return the conditions under which a bag was recorded; `LEVEL` if the bag does not store any."""
    records = [dict(record.values) for record in bag.records if record.name == RUN_RECORD]
    try:
        found = {
            Conditions(**{name: float(record[name]) for name in CONDITION_ROWS if name in record})
            for record in records
        }
    except ValueError as error:
        raise ManifestError(f"{bag.path}: its conditions cannot be used ({error})") from None
    if len(found) > 1:
        raise ManifestError(
            f"{bag.path}: its runs were recorded under different conditions; use one bag per run"
        )
    return found.pop() if found else LEVEL


def recorded_robot(bag: Bag, parameter_file: str = "") -> ParameterFile:
    """Return the parameters for the evaluation of a bag's runs, with the loads of its recorded conditions.

    Args:
        bag: an open bag.
        parameter_file: a parameter file; empty: the file inside the bag, or the paper's values without such a file.
    """
    if parameter_file:
        content = load_parameter_file(parameter_file)
    else:
        content = recorded_parameters(bag) or ParameterFile()
    return content_under(recorded_conditions(bag), content)


def recorded_parameters(bag: Bag) -> ParameterFile | None:
    """Return the parameter file inside a bag, None without one."""
    texts = {file.data for file in bag.attachments() if file.name == PARAMETER_ATTACHMENT}
    if not texts:
        return None
    if len(texts) > 1:
        raise ManifestError(
            f"{bag.path}: its runs were recorded with different parameter files; give --parameters FILE for all of them"
        )
    try:
        return parse_parameter_file(yaml.safe_load(texts.pop()))
    except (ParameterError, yaml.YAMLError) as error:
        raise ManifestError(
            f"{bag.path}: its parameter file cannot be used ({error}); give --parameters FILE"
        ) from None


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ManifestError(f"cannot read the parameter file {path}: {error.strerror}") from None


def _notes(notes: Sequence[str]) -> Mapping[str, str]:
    texts = {}
    for note in notes:
        key, separator, value = note.partition("=")
        if not key or not separator:
            raise ManifestError(f"a note is written KEY=VALUE, not {note!r}")
        if not is_text(note):
            raise ManifestError(f"a note is not UTF-8 text: {note!r}")
        texts[f"note.{key}"] = value
    return texts


def is_text(text: str) -> bool:
    """Return True if a text can be written as UTF-8, and False for an argument with invalid bytes."""
    return not any("\ud800" <= character <= "\udfff" for character in text)
