# SPDX-License-Identifier: Apache-2.0
"""Command tune, on a sample bag."""

import json
from pathlib import Path

import pytest

from worm_optimizer.commands import tune

FORWARD = Path(__file__).resolve().parents[4] / "bags" / "forward"


def test_it_prints_the_next_gait(run):
    status, out, _ = run(tune, FORWARD, "--json")
    found = json.loads(out)
    assert status == 0
    assert found["state"] in ("run", "done", "impossible")
    assert found["gait"]["stroke"] <= 0.09
    keeps = found["keeps_probability"]
    assert 0.0 <= keeps["low"] <= keeps["value"] <= keeps["high"] <= 1.0
    assert found["reason"]


@pytest.mark.parametrize("aim", [("--strokes", "0.01", "0.04"), ("--grooves", "5")])
def test_grooves_that_no_stroke_reaches_are_impossible(run, aim):
    status, out, _ = run(tune, FORWARD, *aim, "--json")
    assert (status, json.loads(out)["state"]) == (0, "impossible")
