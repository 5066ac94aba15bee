# SPDX-License-Identifier: Apache-2.0
"""A recording that is read in parts gives the same samples, outputs and report as the whole at once."""

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples
from recorded_run import SERIES, joined, simulated_run
from twin_samples import rows_of_run

from worm_model.analysis.replay_metrics import ReplayReporter, report_replay
from worm_model.parameters import PAPER
from worm_model.run import LengthSamples, Run
from worm_model.twin.data.samples import SAMPLE, SampleKind
from worm_model.twin.offline_replay import OfflineReplay, replay_run, unusable_runs
from worm_model.twin.recorded_samples import RecordedSamples

RUN = simulated_run(2)


def rows_of_parts(parts: list[Run]) -> list[np.ndarray]:
    return list(RecordedSamples(lambda: iter(parts)).rows())


def divided(run: Run, count: int, delay: Callable[[str], int] = lambda _: 0) -> list[Run]:
    """Return parts of a run in order of reception; the samples of a topic arrive later by its delay in ns."""
    borders = np.linspace(run.origin, run.origin + 10 * 10**9, count + 1)[1:-1]
    parts: list[dict] = [{} for _ in range(count)]
    for name in SERIES:
        series = getattr(run, name)
        number = np.searchsorted(borders, np.maximum.accumulate(series.stamp + delay(name)))
        for k, part in enumerate(parts):
            columns = {f.name: getattr(series, f.name)[number == k] for f in fields(series)}
            part[name] = type(series)(**columns)
    return [
        Run(origin=min((s.stamp[0] for s in part.values() if len(s.stamp)), default=0), **part)
        for part in parts
    ]


@pytest.mark.parametrize("count", [1, 7, 60])
def test_parts_give_the_outputs_and_the_report_of_the_whole(count: int):
    parts = divided(RUN, count)
    replay = OfflineReplay(lambda: parts, PAPER)
    reporter = replay.feed(lambda: ReplayReporter(replay.samples, PAPER.pitch))
    report, events = reporter.report(replay.unusable), reporter.events
    states = np.concatenate([output.states for _, output in replay.steps()])
    whole = replay_run(RUN, PAPER)
    assert states["rear_position"].tolist() == whole.states["rear_position"].tolist()
    assert tuple(events) == whole.notices
    expected = report_replay(RUN, whole, PAPER.pitch)
    assert [c.grooves for c in report.cycles] == [c.grooves for c in expected.cycles]
    for found, other in zip(report.cycles, expected.cycles, strict=True):
        assert found.measured_grooves == pytest.approx(other.measured_grooves)
        assert vars(found.residuals) == pytest.approx(vars(other.residuals))
    assert vars(report.residuals) == pytest.approx(vars(expected.residuals))
    assert report.energy_error == pytest.approx(expected.energy_error)
    assert [(run.onset, run.health) for run in report.runs] == [
        (run.onset, run.health) for run in expected.runs
    ]


@examples(25)
@given(
    delays=st.tuples(*[st.integers(0, 2 * 10**9)] * len(SERIES)),
    count=st.integers(1, 40),
    set_by=st.sampled_from([0, -(10**9) // 2, -3 * 10**9, -40 * 10**9, 5 * 10**9]),
    at=st.integers(0, 6 * 10**9),
)
def test_parts_give_the_samples_in_the_order_of_the_whole(delays, count, set_by, at):
    """For any delay of a topic on its way to the recorder, and also if the clock is set."""

    def with_jump(stamp: np.ndarray) -> np.ndarray:
        return np.where(stamp > RUN.origin + at, stamp + set_by, stamp)

    delay = dict(zip(SERIES, delays, strict=True))
    parts = [
        replace(
            part,
            **{
                name: replace(getattr(part, name), stamp=with_jump(getattr(part, name).stamp))
                for name in SERIES
            },
        )
        for part in divided(RUN, count, delay.__getitem__)
    ]
    whole = joined(parts)
    found = np.concatenate([np.zeros(0, SAMPLE), *rows_of_parts(parts)])
    assert found.tobytes() == rows_of_run(whole).tobytes()
    one, many = (RecordedSamples(lambda r=r: iter(r)) for r in ([whole], parts))
    assert one.clock_went_back == many.clock_went_back
    assert (one.first_ns, one.last_ns) == (many.first_ns, many.last_ns)
    assert one.impossible_steps.tolist() == many.impossible_steps.tolist()
    assert unusable_runs(one) == unusable_runs(many)


def test_no_more_than_the_samples_of_two_parts_wait():
    """Memory does not grow with the recording: the samples of a part are yielded with it or the next one."""
    parts = divided(RUN, 30)
    received = yielded = 0
    for part, rows in zip(parts, rows_of_parts(parts), strict=True):
        received += sum(len(getattr(part, name).stamp) for name in SERIES)
        yielded += len(rows)
        assert received - yielded <= 60


def test_a_recording_without_samples_has_no_rows():
    empty = RecordedSamples(lambda: iter(()))
    assert list(empty.rows()) == []
    assert (empty.first_ns, empty.last_ns, empty.origin) == (None, None, 0)
    assert len(rows_of_run(Run())) == 0


def test_a_command_that_jumps_to_and_fro_is_found_across_parts():
    stamp = RUN.origin + 10**7 * np.arange(40)
    change = np.where(np.arange(40) % 2, 0.0, -0.05)
    parts = [
        Run(
            origin=int(stamp[k]),
            commanded=LengthSamples(stamp[k : k + 1], change[k : k + 1], change[k : k + 1]),
        )
        for k in range(40)
    ]
    found = RecordedSamples(lambda: iter(parts))
    assert len(found.impossible_steps) == 39
    assert sum((rows["kind"] == SampleKind.COMMAND).sum() for rows in found.rows()) == 40
