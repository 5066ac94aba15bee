# SPDX-License-Identifier: Apache-2.0
"""The drawing is to scale, and shows the robot only where the tracker measures it."""

import math
from dataclasses import replace
from xml.etree import ElementTree

from worm_model.parameters import PAPER
from worm_model.run import LengthSource
from worm_model.twin.data.records import StateRecord
from worm_model.twin.scene import MODULE, PIPE_RADIUS, PositionSample
from worm_optimizer.console.picture import picture

TWIN = StateRecord(0, LengthSource.MEASURED, *(0.3, 0.0, 0.3, 0.0, 0.10, 0.40, 0.0, 0.0, 0.09, 0.39),
                   *(0, 0), *(0.0, 0.0, 0.0, 2.0, 0.0))  # fmt: skip


def boxes(text: str, kind: str) -> list[ElementTree.Element]:
    root = ElementTree.fromstring(text)
    return [element for element in root if element.get("class") == kind]


def number(element: ElementTree.Element, name: str) -> float:
    return float(element.get(name, "nan"))


def test_modules_stand_where_they_are_in_mm():
    text = picture(TWIN, PositionSample(0.11, 0.41, 0), PAPER)
    for kind, places in (("ghost", (0.10, 0.40)), ("robot", (0.11, 0.41))):
        shown = boxes(text, kind)
        assert len(shown) == 2
        for box, place in zip(shown, places, strict=True):
            assert math.isclose(number(box, "x"), 1e3 * (place - 0.5 * MODULE[0]), abs_tol=0.06)
            assert number(box, "width") == 1e3 * MODULE[0]


def test_the_pipe_is_as_wide_as_it_is():
    walls = [box for box in boxes(picture(TWIN, PositionSample(), PAPER), "pipe")
             if number(box, "width") > 100.0]  # fmt: skip
    upper, lower = sorted(number(box, "y") for box in walls)
    assert math.isclose(lower - (upper + number(walls[0], "height")), 2e3 * PIPE_RADIUS)


def test_a_robot_that_is_not_measured_is_not_drawn():
    text = picture(TWIN, PositionSample(), PAPER)
    assert boxes(text, "robot") == []
    assert "not seen" in text


def test_fins_change_their_colour_with_what_they_do():
    held = boxes(picture(TWIN, PositionSample(), PAPER), "fins")
    pushed = replace(TWIN, rear_anchor=0.11, front_anchor=0.41)
    yielding = boxes(picture(pushed, PositionSample(), PAPER), "fins")
    assert {box.get("style") for box in held}.isdisjoint(box.get("style") for box in yielding)
    reverse = boxes(picture(pushed, PositionSample(), PAPER, -1), "fins")
    assert {box.get("style") for box in reverse} == {box.get("style") for box in held}


def test_without_a_twin_there_is_a_note():
    assert "no data of the twin" in picture(None, PositionSample(), PAPER)


def test_the_view_rests_while_the_robot_moves_a_little():
    def view(shift: float) -> str | None:
        moved = replace(TWIN, rear_position=0.1 + shift, front_position=0.4 + shift)
        return ElementTree.fromstring(picture(moved, PositionSample(), PAPER)).get("viewBox")

    assert view(0.0) == view(0.02)
    assert view(0.0) != view(0.2)
