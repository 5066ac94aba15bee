# SPDX-License-Identifier: Apache-2.0
"""Estimates, from single bags, of the parameters that may drift (`drift.ADVICE`)."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.errors import IdentificationError, InputError
from worm_model.gait import Gait, GaitError
from worm_model.identification.actuation_stage import identify_actuation
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.data.strides import check_pitch
from worm_model.identification.drift import MARGIN
from worm_model.identification.fits.estimate import Estimate, admissible, not_identifiable
from worm_model.identification.fits.locomotion import Known, traverse_of
from worm_model.identification.fits.measured_length import measured_length
from worm_model.identification.fits.quality import LONGEST_GAP, remarks, usable
from worm_model.identification.held_out import margin_estimate
from worm_model.identification.idle import idle_power, idle_power_of
from worm_model.identification.inputs import read_bag
from worm_model.identification.locomotion_stage import identify_locomotion
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import SimulationError

SEED = 0  # fixed seed of the bootstrap, so that equal bags result in equal intervals


@dataclass(frozen=True)
class BagEstimates:
    """Estimates from one bag.

    Attributes:
        name: name of the bag.
        date: start of the bag in UTC, to the second.
        gait: gait of the run.
        estimates: estimates by key, for the keys of `drift.ADVICE`.
        remarks: remarks on the data.
    """

    name: str
    date: str
    gait: Gait
    estimates: Mapping[str, Estimate]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class ExcludedBag:
    """Bag that was excluded, with the ``reason``."""

    name: str
    reason: str


def estimate_bags(
    paths: Sequence[Path],
    parameters: Parameters,
    progress: Callable[[float], None] = lambda _done: None,
) -> tuple[tuple[BagEstimates, ...], tuple[ExcludedBag, ...]]:
    """Estimate, from the first run in each bag, the parameters that may drift.

    Args:
        paths: the bags.
        parameters: values of all other parameters.
        progress: called with the completed share, 0 to 1.

    Returns:
        The estimates, ordered by start, and the excluded bags.
    """
    by_bag: dict[str, BagEstimates] = {}
    excluded = []
    for done, path in enumerate(paths):
        progress(done / len(paths))
        try:
            recording = read_bag(path)[0]
            content = _content(recording)
            if content in by_bag:
                raise IdentificationError(f"the same run as {by_bag[content].name}")
            by_bag[content] = estimate_bag(recording, parameters)
        except (BagError, GaitError, IdentificationError, SimulationError) as error:
            excluded.append(ExcludedBag(path.name, str(error)))
        except InputError:
            raise
        except (ValueError, np.linalg.LinAlgError) as error:
            # An unforeseen problem in one bag must not prevent the evaluation of the other bags.
            excluded.append(
                ExcludedBag(path.name, f"the fit failed ({error}); check the bag's data")
            )
    progress(1.0)
    bags = sorted(by_bag.values(), key=lambda bag: (bag.date, bag.name))
    return tuple(_with_margins_of_one_gait(bags)), tuple(excluded)


def _with_margins_of_one_gait(bags: Sequence[BagEstimates]) -> list[BagEstimates]:
    """Return the bags, with a margin only if they have the gait of the last bag, because it depends on the gait."""
    other = not_identifiable(np.nan, "another gait than that of the last bag")
    return [
        bag
        if bag.gait == bags[-1].gait
        else replace(bag, estimates={**bag.estimates, MARGIN: other})
        for bag in bags
    ]


def _content(recording: Recording) -> str:
    """Return a hash of the tracker's samples and the command.

    It identifies a run even if an import has assigned arbitrary stamps, because the times are counted from the onset.
    """
    digest = hashlib.sha256()
    for values in (recording.camera_time, recording.x1, recording.x2, recording.command):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def estimate_bag(recording: Recording, parameters: Parameters) -> BagEstimates:
    """Estimate, from a recording, the parameters that may drift."""
    _check_seen(recording)
    length = measured_length(recording)
    usable([recording], [length])
    check_pitch([recording], parameters.pitch)
    traverse = traverse_of(recording, length, parameters.pitch)
    known = parameters.replace(initial_length=length.initial_length)
    locomotion = identify_locomotion([traverse], Known(known, 0.0))
    actuation = identify_actuation([recording], np.random.default_rng(SEED))
    estimates = {
        "viscous_friction": locomotion.viscous_friction,
        "switching_threshold": locomotion.switching_threshold,
        "gain": actuation.gain,
        "slack": actuation.slack,
        "idle_power": _idle_power(recording),
    }
    estimates = {key: admissible(key, estimate) for key, estimate in estimates.items()}
    estimates[MARGIN] = margin_estimate(recording, parameters)
    notes = tuple(remarks(recording, length, traverse))
    return BagEstimates(recording.name, recording.date, recording.gait, estimates, notes)


def _check_seen(recording: Recording) -> None:
    """Raise IdentificationError if a marker was hidden for more than `LONGEST_GAP`.

    In a fit to several runs, the other runs compensate for such a gap. Here, the run is fitted alone.
    """
    time = recording.camera_time
    times = time[np.isfinite(recording.length) & (time > 0.0) & (time < recording.end)]
    gap = float(np.diff(np.concatenate([[0.0], times, [recording.end]])).max())
    if gap > LONGEST_GAP:
        raise IdentificationError(
            f"{recording.name}: a marker is hidden for {gap:.1f} s of the gait, {LONGEST_GAP:g} s at most are allowed; "
            "record the run again with both markers visible"
        )


def _idle_power(recording: Recording) -> Estimate:
    """Return the idle power.

    It is not identifiable if too few of the run's first power samples were measured at rest (see `idle_power_of`), or
    if the cable held a pretension.
    """
    idle = idle_power_of(recording)
    return idle_power([idle]) or Estimate(np.nan, np.nan, np.nan, False, idle.warning)
