# SPDX-License-Identifier: Apache-2.0
"""Measured margins in the states of the twin."""

import dataclasses
from functools import lru_cache

import numpy as np
import pytest
from foreign_robot import EPOCH, crawl, some_robot
from twin_samples import rows_of_run
from virtual_session import live_twin

from worm_model.analysis.run_metrics import measure_margin
from worm_model.gait import Gait
from worm_model.margin.half_cycles import Fin
from worm_model.parameters import PAPER
from worm_model.run import Run, TrackerSamples
from worm_model.twin.data.samples import topic_rows
from worm_model.twin.offline_replay import OfflineReplay
from worm_model.twin.run_margins import NO_MARGINS, STORED, RunPositions

GAIT, CYCLES = Gait(0.075, 0.2), 6


@lru_cache
def recorded() -> Run:
    return crawl(some_robot(1), GAIT, CYCLES, seed=1).run


def replayed(run: Run) -> np.ndarray:
    steps = OfflineReplay(lambda: (run,), PAPER).steps()
    return np.concatenate([output.states for _, output in steps])


def test_the_margins_of_live_twin_and_replay_are_the_same():
    live = live_twin(rows_of_run(recorded()), many=20).states
    offline = replayed(recorded())
    for name in NO_MARGINS:
        assert np.array_equal(live[name], offline[name], equal_nan=True)


def test_the_margins_are_published_from_the_end_of_each_cycle_on():
    states = replayed(recorded())
    whole = measure_margin(recorded(), PAPER)
    for cycle in (3, 4, 5):
        middle = EPOCH + round((cycle + 0.5) * GAIT.period * 1e9)
        row = int(np.searchsorted(states["stamp_ns"], middle))
        shown, found = states["last_rear_margin"][row], whole.cycles[cycle - 1].rear.margin
        assert shown == pytest.approx(found, abs=0.0005)
    for fin in Fin:
        shown = states[f"{fin.value}_margin"][-1]
        assert shown == pytest.approx(whole.beliefs[fin].expected, abs=0.0005)
    assert states["margin_grooves"][-1] == whole.grooves
    assert whole.keeps is not None
    assert states["keeps_probability"][-1] == pytest.approx(whole.keeps.value, abs=0.05)


def test_without_a_tracker_and_before_the_second_cycle_the_margins_are_nan():
    states = replayed(dataclasses.replace(recorded(), tracker=TrackerSamples()))
    assert np.isnan(states["rear_margin"]).all()
    assert np.isnan(states["last_front_margin"]).all()
    states = replayed(recorded())
    first = states["stamp_ns"] < EPOCH + round(1.9 * GAIT.period * 1e9)
    assert np.isnan(states["rear_margin"][first]).all()


def test_the_number_of_stored_positions_is_bounded():
    positions = RunPositions()
    rows = topic_rows(recorded())
    for _ in range(1 + STORED // len(recorded().tracker.stamp)):
        for each in rows.values():
            positions.add(each)
    assert len(positions.__dict__["_stamp"]) == STORED
