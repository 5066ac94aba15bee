# SPDX-License-Identifier: Apache-2.0
"""The runs of an identification, and the spread of repeated gaits."""

import math
from types import SimpleNamespace

import pytest

from worm_model.identification.fits.locomotion import RIDGES
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.operation.campaign_plan import draw_spread, run_names, spread, spread_table
from worm_optimizer.operation.identification_runs import identification_orders
from worm_optimizer.report.expectation import Band, Bands

FREQUENCY = 0.2


def run(grooves: float, poorest: float):
    """Return a recorded gait for the spread: grooves per cycle on average and in the worst cycle."""
    speeds = [each * PAPER.pitch * FREQUENCY for each in (grooves, poorest)]
    return SimpleNamespace(
        content=SimpleNamespace(parameters=PAPER),
        gait=SimpleNamespace(frequency=FREQUENCY),
        measured=Bands(
            Band(speeds[0], speeds[1], speeds[0]), Band(2.0, 2.0, 2.0), Band(60.0, 60.0, 60.0)
        ),
    )


PROMISE = SimpleNamespace(grooves_per_cycle=2.01, speed=2 * PAPER.pitch * FREQUENCY)


def test_a_promise_is_kept_where_every_averaged_cycle_gains_its_grooves():
    found = spread("cruise", PROMISE, [run(2.0, 1.98), run(1.67, 1.02), run(2.3, 1.9)])
    assert (found.promised, found.kept, found.repeats) == (2, 2, 3)
    assert found.means["power"] == 2.0
    assert found.deviations["power"] == 0.0
    assert found.deviations["speed"] > 0.0
    assert math.isnan(spread("cruise", PROMISE, [run(2.0, 2.0)]).deviations["speed"])


@pytest.mark.parametrize("direction", [1, -1])
def test_every_planned_gait_passes_the_ridges_in_its_cycles_at_three_frequencies(direction):
    orders = identification_orders(direction, PAPER.pitch)
    assert len({order.gait.frequency for order in orders.values()}) >= 3
    assert len({order.gait.stroke for order in orders.values()}) >= 3
    for order in orders.values():
        assert order.distance > RIDGES * PAPER.pitch
        reached = abs(evaluate_gait(order.gait, PAPER).speed) * order.cycles * order.gait.period
        assert reached > 1.3 * order.distance


def test_the_table_and_the_figure_name_robust_and_nominal_gaits(tmp_path):
    rows = [spread(name, PROMISE, [run(2.0, 2.0)] * 2) for name in ("cruise", "nominal_cruise")]
    text = spread_table(rows)
    assert "2 of 2 (2 a cycle)" in text
    assert "cruising, nominal" in text
    draw_spread(tmp_path / "spread.png", rows)
    assert (tmp_path / "spread.png").read_bytes().startswith(b"\x89PNG")


def test_repeats_of_one_gait_do_not_follow_each_other():
    assert run_names(("a", "b"), 1) == {"a": "a", "b": "b"}
    assert list(run_names(("a", "b"), 2)) == ["a_1", "b_1", "a_2", "b_2"]
    assert run_names(("a",), 2) == {"a_1": "a", "a_2": "a"}
