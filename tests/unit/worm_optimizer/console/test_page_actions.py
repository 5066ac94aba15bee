# SPDX-License-Identifier: Apache-2.0
"""Ends of a run that a page started."""

import dataclasses
import math
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from worm_model.gait import Gait
from worm_msgs.conditions import LEVEL
from worm_optimizer.console import page_actions
from worm_optimizer.console.robot_worker import STOP_PRESSED
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import RejectedStartError
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.robot_commands import GaitCommand, RunResult
from worm_optimizer.search.gait_request import GaitRequest, Objective

GAIT = Gait(0.03, 0.2, 1)


def run(
    monkeypatch: pytest.MonkeyPatch, *cancellations: str, success: bool, rejected: bool = False
) -> str:
    """Run a gait with the responses of `cancellation`, from the start of the run to its end."""
    gait_run = SimpleNamespace(result=RunResult(GAIT, success, "the result"), rejected=rejected)
    node = SimpleNamespace(
        started=lambda *_: nullcontext(gait_run),
        follow=lambda *_: None,
        conditions=lambda: LEVEL,
        get_namespace=lambda: "/worm",
    )
    for name in ("recorder_of", "new_bag"):
        monkeypatch.setattr(page_actions, name, lambda *_: None)
    monkeypatch.setattr(page_actions, "recorded", lambda *_: nullcontext(Path("run_1")))
    answers = iter(cancellations)
    command = GaitCommand(GAIT, cycles=2)
    return page_actions.run(node, command, Path(), "", lambda: next(answers), lambda _: None)


def test_a_run_that_a_person_stops_is_no_error(monkeypatch: pytest.MonkeyPatch):
    text = run(monkeypatch, "", STOP_PRESSED, success=False)
    assert all(part in text for part in ("the result", STOP_PRESSED, "run_1"))


@pytest.mark.parametrize("why", ["", "no page has control"])
def test_any_other_failure_is_an_error_with_its_reason(monkeypatch: pytest.MonkeyPatch, why: str):
    with pytest.raises(OperatorError, match=f"the result; .*{why}.*run_1"):
        run(monkeypatch, "", why, success=False)


def test_a_cancelled_run_does_not_start(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(OperatorError, match="not started"):
        run(monkeypatch, STOP_PRESSED, success=True)


def test_a_rejected_gait_is_an_error_within_its_recording(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(RejectedStartError, match="the result"):
        run(monkeypatch, "", "", success=False, rejected=True)


class Optimizer:
    """Fake operator whose front has a power of speed squared; a gait may be faster than requested."""

    def __init__(self, *, exists: bool = True) -> None:
        self.has_optimizer = lambda: exists

    def request_gait(
        self, request: GaitRequest, direction: int, length: float
    ) -> tuple[Prediction, str]:
        fixed = {Objective.MIN_POWER: 1e-3, Objective.CRUISE: 2.5e-3, Objective.MAX_SPEED: 8e-3}
        speed = fixed.get(request.objective) or math.ceil(1e3 * request.value) * 1e-3
        values = dict.fromkeys((row.name for row in dataclasses.fields(Prediction)), 0.1)
        known = {"direction": direction, "profile": 0, "speed": speed, "groove_phase": length}
        return Prediction(**(values | known)), "margin 3.00 mm; warning: none"


def test_a_front_is_read_by_rising_speed_and_contains_the_cruise():
    front = page_actions.read_front(Optimizer(), -1, 0.0)
    speeds = [1e3 * gait.speed for gait in front.gaits]
    assert speeds == pytest.approx([1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0])
    assert front.cruise in front.gaits
    assert front.description == "margin 3.00 mm"


def test_without_an_optimizer_there_is_no_front_at_once():
    with pytest.raises(OperatorError, match="no optimizer"):
        page_actions.read_front(Optimizer(exists=False), 1, 0.0)


def test_a_front_that_ends_elsewhere_than_before_says_so_with_both_groove_phases():
    before = page_actions.read_front(Optimizer(), 1, 1.1e-3)
    same = page_actions.read_front(Optimizer(), 1, 1.3e-3)
    faster = dataclasses.replace(same.gaits[-1], speed=11.9e-3)
    after = dataclasses.replace(same, gaits=(*same.gaits, faster))
    for text in (page_actions.described(before, None), page_actions.described(before, before)):
        assert "1.1 mm" in text
        assert "8.00 mm/s" not in text
    text = page_actions.described(after, before)
    assert all(fact in text for fact in ("11.90 mm/s", "8.00 mm/s", "1.1 mm", "1.3 mm"))


def test_predictions_hold_for_the_length_of_the_front_until_the_groove_phase_has_changed():
    front = page_actions.read_front(Optimizer(), 1, 1.1e-3)
    twin = SimpleNamespace(initial_length=0.29524, groove_phase=1.14e-3)
    assert page_actions.initial_length(twin, front) == pytest.approx(0.2952)
    assert page_actions.initial_length(twin) == twin.initial_length
    moved = SimpleNamespace(initial_length=0.2954, groove_phase=1.3e-3)
    assert page_actions.initial_length(moved, front) == moved.initial_length
    assert page_actions.initial_length(None, front) == 0.0
