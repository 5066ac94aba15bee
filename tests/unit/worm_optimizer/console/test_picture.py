# SPDX-License-Identifier: Apache-2.0
"""The drawing is to scale, its fins bend to their grooves, and it shows a robot only where the tracker sees it."""

import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from worm_model.parameters import PAPER
from worm_model.run import LengthSource
from worm_model.twin.data.records import StateRecord
from worm_model.twin.scene import PositionSample
from worm_optimizer.console.picture import MODULE_WIDTH, picture

TWIN = StateRecord(0, LengthSource.MEASURED, *(0.3, 0.0, 0.3, 0.0, 0.10, 0.40, 0.0, 0.0, 0.09, 0.39),
                   *(0, 0), *(0.0, 0.0, 0.0, 2.0, 0.0))  # fmt: skip
SEEN, UNSEEN = PositionSample(0.11, 0.41, 0), PositionSample()


def shapes(text: str, kind: str) -> list[ElementTree.Element]:
    root = ElementTree.fromstring(text)
    return [element for element in root if kind in element.get("class", "").split()]


def points(element: ElementTree.Element) -> list[float]:
    return [float(number) for number in re.findall(r"-?[0-9.]+", element.get("d", ""))]


def drawn(twin: StateRecord = TWIN, robot: PositionSample = UNSEEN, direction: int = 1) -> str:
    return picture(twin, robot, PAPER, direction)


def test_modules_stand_where_they_are_in_mm():
    for kind, places in (("twin", (100.0, 400.0)), ("robot", (110.0, 410.0))):
        modules = [box for box in shapes(drawn(robot=SEEN), kind) if box.get("x")]
        middles = [float(box.get("x", "nan")) + 0.5 * MODULE_WIDTH for box in modules]
        assert middles == pytest.approx(places, abs=0.01)


def test_fins_begin_at_their_module_and_end_in_their_groove():
    fins = shapes(drawn(), "fin")
    assert [points(fin)[0] for fin in fins] == pytest.approx([100.0, 100.0, 400.0, 400.0])
    assert [points(fin)[-2] for fin in fins] == pytest.approx([90.0, 90.0, 390.0, 390.0])


def test_the_wall_has_a_groove_at_the_anchor():
    """A half wave outwards, as wide as half a pitch, begins a quarter of a pitch before each groove."""
    start, pitch = points(shapes(drawn(), "pipe")[0])[0], 1e3 * PAPER.pitch
    phase = (90.0 - start) / pitch
    assert phase - math.floor(phase) == pytest.approx(0.25, abs=1e-3)


def test_a_robot_that_is_not_measured_is_not_drawn():
    assert shapes(drawn(robot=SEEN), "robot")
    assert shapes(drawn(), "robot") == []
    assert "not seen" in drawn()


def test_fins_show_what_they_do_without_colours_too():
    pushed = replace(TWIN, rear_anchor=0.11, front_anchor=0.41)
    for state, direction, kind in ((TWIN, 1, "yield"), (pushed, 1, "hold"), (pushed, -1, "yield")):
        text = drawn(state, direction=direction)
        assert len(shapes(text, kind)) == 4
        assert f"rear fins {kind}" in text
    resting = replace(TWIN, rear_anchor=0.10, front_anchor=0.40)
    assert len(shapes(drawn(resting), "touch")) == 4


def test_the_view_rests_while_the_robot_moves_a_little():
    def view(shift: float) -> str | None:
        moved = replace(TWIN, rear_position=0.1 + shift, front_position=0.4 + shift)
        return ElementTree.fromstring(drawn(moved)).get("viewBox")

    assert view(0.0) == view(0.02)
    assert view(0.0) != view(0.2)
