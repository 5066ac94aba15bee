# SPDX-License-Identifier: Apache-2.0
"""Estimates, from single bags, of the parameters that may drift (`drift.ADVICE`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from worm_model.errors import IdentificationError
from worm_model.identification.actuation_stage import identify_actuation
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.data.strides import check_pitch
from worm_model.identification.drift import MARGIN
from worm_model.identification.fits.estimate import Estimate, admissible, not_identifiable
from worm_model.identification.fits.locomotion import Known, traverse_of
from worm_model.identification.fits.measured_length import measured_length
from worm_model.identification.fits.quality import LONGEST_GAP, remarks, usable
from worm_model.identification.fits.resampling import SEED
from worm_model.identification.held_out import margin_estimate
from worm_model.identification.idle import idle_power, idle_power_of
from worm_model.identification.inputs import read_bag
from worm_model.identification.locomotion_stage import identify_locomotion
from worm_model.parameters import ParameterError, Parameters
from worm_model.simulation.simulator import SimulationError


@dataclass(frozen=True)
class BagEstimates:
    """First run in a bag, estimates by key, for the keys of `drift.ADVICE`, and remarks on the data."""

    recording: Recording
    estimates: dict[str, Estimate]
    remarks: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the bag."""
        return self.recording.name


@dataclass(frozen=True)
class ExcludedBag:
    """Bag that was excluded, with the ``reason``."""

    name: str
    reason: str

    def __str__(self) -> str:
        """Return the reason, preceded by the bag's name unless the reason contains the name."""
        return self.reason if self.name in self.reason else f"{self.name}: {self.reason}"


def estimate_bags(
    paths: Sequence[Path],
    parameters: Parameters,
    progress: Callable[[float], None] = lambda _done: None,
) -> tuple[list[BagEstimates], list[ExcludedBag]]:
    """Estimate, from the first run in each bag, the parameters that may drift.

    Args:
        paths: the bags; one that is listed twice counts once.
        parameters: values of all other parameters.
        progress: called with the completed share, 0 to 1.

    Returns:
        The estimates, ordered by start, and the excluded bags.
    """
    bags: list[BagEstimates] = []
    excluded: list[ExcludedBag] = []
    seen: dict[tuple[str, ...], str] = {}
    for done, path in enumerate(dict.fromkeys(path.resolve() for path in paths)):
        progress(done / len(paths))
        try:
            recording = read_bag(path)[0]
            content = tuple(sorted(recording.sources.values()))
            if content and content in seen:
                raise IdentificationError(f"the same run as {seen[content]}")
            seen[content] = recording.name
            bags.append(estimate_bag(recording, parameters))
        except ParameterError:
            raise
        except (ValueError, SimulationError) as error:  # must not prevent the use of the other bags
            excluded.append(ExcludedBag(path.name, str(error)))
    progress(1.0)
    bags.sort(key=lambda bag: (bag.recording.date, bag.name))
    for bag in bags:  # a margin depends on the gait
        if bag.recording.gait != bags[-1].recording.gait:
            note = "another gait than that of the last bag"
            bag.estimates[MARGIN] = not_identifiable(np.nan, note)
    return bags, excluded


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
    idle = idle_power_of(recording)
    estimates = {
        "viscous_friction": locomotion.viscous_friction,
        "switching_threshold": locomotion.switching_threshold,
        "gain": actuation.gain,
        "slack": actuation.slack,
        "idle_power": idle_power([idle]) or not_identifiable(np.nan, idle.warning),
    }
    estimates = {key: admissible(key, estimate) for key, estimate in estimates.items()}
    estimates[MARGIN] = margin_estimate(recording, parameters)
    return BagEstimates(recording, estimates, tuple(remarks(recording, length, traverse)))


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
