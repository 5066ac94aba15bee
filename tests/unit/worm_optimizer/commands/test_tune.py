# SPDX-License-Identifier: Apache-2.0
"""Command tune, on a sample bag."""

import json
import sys
from pathlib import Path

import pytest

from worm_optimizer.commands import tune

BAGS = Path(__file__).resolve().parents[4] / "bags"
FORWARD, REVERSE = str(BAGS / "forward"), str(BAGS / "reverse")


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["tune", *arguments])
    return tune.main()


def test_it_prints_the_next_gait(monkeypatch: pytest.MonkeyPatch, capsys):
    assert run(monkeypatch, FORWARD, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["state"] in ("run", "done", "impossible")
    assert found["gait"]["stroke"] <= 0.09
    keeps = found["keeps_probability"]
    assert 0.0 <= keeps["low"] <= keeps["value"] <= keeps["high"] <= 1.0
    assert found["reason"]


def test_a_limit_of_the_robot_bounds_the_stroke(monkeypatch: pytest.MonkeyPatch, capsys):
    assert run(monkeypatch, FORWARD, "--strokes", "0.01", "0.06", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["state"] == "run"
    assert found["gait"]["stroke"] <= 0.06


@pytest.mark.parametrize("aim", [("--strokes", "0.01", "0.04"), ("--grooves", "5")])
def test_grooves_that_no_stroke_reaches_are_impossible(monkeypatch, capsys, aim):
    assert run(monkeypatch, FORWARD, *aim, "--json") == 0
    assert json.loads(capsys.readouterr().out)["state"] == "impossible"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((FORWARD, "--probability", "1"), "--probability"),
        ((FORWARD, "--grooves", "0"), "--grooves"),
        ((FORWARD, FORWARD), "twice"),
        ((FORWARD, REVERSE), "both directions"),
        ((str(BAGS / "faults"),), "not measured"),
        ((str(BAGS / "missing"),), "missing"),
    ],
)
def test_bad_input_is_one_line(monkeypatch: pytest.MonkeyPatch, capsys, arguments, named):
    assert run(monkeypatch, *arguments) == 2
    error = capsys.readouterr().err
    assert named in error
    assert "Traceback" not in error
