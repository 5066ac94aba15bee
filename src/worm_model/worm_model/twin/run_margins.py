# SPDX-License-Identifier: Apache-2.0
"""Measured margins of the running gait, from the tracker samples of its last cycles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import RunMargin, measure_cycles
from worm_model.parameters import Parameters
from worm_model.run import Run, TrackerSamples
from worm_model.twin.data.records import StateRecord
from worm_model.twin.data.samples import SampleKind, SampleRows
from worm_msgs.gait import Gait

STORED = 6000  # largest number of stored samples: 200 s of a camera at 30 Hz
MOST_CYCLES = 8  # that are measured together, so that a long run does not delay the twin


#: margins before any is measured, by field of the message TwinState
NO_MARGINS: dict[str, float] = {
    "margin_grooves": 0,
    "rear_margin": math.nan,
    "front_margin": math.nan,
    "rear_margin_scatter": math.nan,
    "front_margin_scatter": math.nan,
    "last_rear_margin": math.nan,
    "last_front_margin": math.nan,
    "keeps_probability": math.nan,
}


class RunPositions:
    """Newest tracker samples, bounded in number."""

    def __init__(self) -> None:
        self._stamp, self._places = np.zeros(0, np.int64), np.zeros((2, 0))

    def add(self, samples: SampleRows) -> None:
        """Add the positions among the samples (n,) of SAMPLE."""
        rows = samples[samples["kind"] == SampleKind.POSITION]
        self._stamp = np.append(self._stamp, rows["stamp"])[-STORED:]
        self._places = np.append(self._places, [rows["a"], rows["b"]], axis=1)[:, -STORED:]

    def margins(
        self, gait: Gait, parameters: Parameters, onset_ns: int, cycles: int
    ) -> MarginsAtCycle:
        """Return the margins at the end of a cycle of a run, from at most `MOST_CYCLES` cycles.

        Later samples do not count, so that a replay has the same result as the live twin.

        Args:
            gait: gait of the run.
            parameters: parameters of the robot.
            onset_ns: onset of the run, ns.
            cycles: number of complete cycles.
        """
        left_out = max(cycles - MOST_CYCLES, 0)
        start, end = (onset_ns + round(k * gait.period * 1e9) for k in (left_out, cycles))
        used = (start <= self._stamp) & (self._stamp <= end)
        run = Run(tracker=TrackerSamples(self._stamp[used], *self._places[:, used]))
        return MarginsAtCycle(run, gait, parameters, start, cycles - left_out)


@dataclass(frozen=True, eq=False)
class MarginsAtCycle:
    """Margins at the end of a cycle of a run, from tracker samples that begin at a start in ns.

    They are measured when they are read, because this takes longer than all else that the twin does in a cycle.
    """

    run: Run
    gait: Gait
    parameters: Parameters
    start_ns: int
    cycles: int

    @cached_property
    def values(self) -> dict[str, float]:
        """Margins by field of the message TwinState, as in `NO_MARGINS`."""
        found = measure_cycles(self.run, self.gait, self.start_ns, self.cycles, self.parameters)
        return _values(found)


def _values(run: RunMargin) -> dict[str, float]:
    values = NO_MARGINS | {"margin_grooves": run.grooves}
    for fin in Fin:
        margin = run.margins(fin)[0]
        belief = run.beliefs.get(fin)
        values[f"last_{fin.value}_margin"] = float(margin[-1]) if margin.size else math.nan
        if belief is not None:
            values[f"{fin.value}_margin"] = belief.expected
            values[f"{fin.value}_margin_scatter"] = belief.expected_scatter
    if run.least is not None:
        values["keeps_probability"] = math.prod(fin.chance for fin in run.beliefs.values())
    return values


def spare_of(state: StateRecord) -> str:
    """Return the smaller margin of both fins in one line, empty if none was measured."""
    fins = (
        (state.rear_margin, state.rear_margin_scatter),
        (state.front_margin, state.front_margin_scatter),
    )
    measured = [fin for fin in fins if math.isfinite(fin[0])]
    if not measured:
        return ""
    margin, scatter = min(measured)
    grooves = f"{state.margin_grooves} groove" + ("" if state.margin_grooves == 1 else "s")
    return f"{grooves}, {1e3 * margin:.1f} ± {1e3 * scatter:.1f} mm to spare"
