# SPDX-License-Identifier: Apache-2.0
"""The runs of an identification, and the spread of repeated gaits."""

from types import SimpleNamespace

import pytest

from worm_model.identification.fits.locomotion import RIDGES
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.operation.campaign_plan import run_names, spread_table
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


PROMISE = SimpleNamespace(grooves_per_cycle=2.01)


def test_a_promise_is_kept_where_every_averaged_cycle_gains_its_grooves():
    text = spread_table(
        {"cruise": PROMISE, "nominal_cruise": PROMISE},
        {
            "cruise": [run(2.0, 1.98), run(1.67, 1.02), run(2.3, 1.9)],
            "nominal_cruise": [run(2.0, 2.0)],
        },
    )
    _, repeated, single = text.splitlines()
    for part in ("cruising", "2 of 3 (2 a cycle)", "2.000 ± 0.000"):
        assert part in repeated
    for part in ("cruising, nominal", "1 of 1 (2 a cycle)", "±"):
        assert part in single


@pytest.mark.parametrize("direction", [1, -1])
def test_every_planned_gait_passes_the_ridges_in_its_cycles_at_three_frequencies(direction):
    orders = identification_orders(direction, PAPER.pitch)
    assert len({order.gait.frequency for order in orders.values()}) >= 3
    assert len({order.gait.stroke for order in orders.values()}) >= 3
    for order in orders.values():
        assert order.distance > RIDGES * PAPER.pitch
        reached = abs(evaluate_gait(order.gait, PAPER).speed) * order.cycles * order.gait.period
        assert reached > 1.3 * order.distance


def test_repeats_of_one_gait_do_not_follow_each_other():
    assert run_names(("a", "b"), 1) == {"a": "a", "b": "b"}
    assert list(run_names(("a", "b"), 2)) == ["a_1", "b_1", "a_2", "b_2"]
    assert run_names(("a",), 2) == {"a_1": "a", "a_2": "a"}
