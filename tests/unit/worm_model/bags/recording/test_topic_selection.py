# SPDX-License-Identifier: Apache-2.0
"""Selection of the topics of a recording."""

import pytest

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.recording.topic_selection import TopicSelection


@pytest.mark.parametrize(
    ("selection", "selected"),
    [
        ({"names": frozenset({"/worm/power"})}, {"/worm/power"}),
        ({"everything": True}, {"/worm/power", "/worm/tracker", "/rosout"}),
        ({"everything": True, "exclude": "out$"}, {"/worm/power", "/worm/tracker"}),
        ({"regex": "^/worm/.*er"}, {"/worm/power", "/worm/tracker"}),
        ({"regex": "feedback"}, set()),
        (
            {"names": frozenset({"/worm/run_gait/_action/feedback"}), "exclude": "feedback"},
            {"/worm/run_gait/_action/feedback"},
        ),
    ],
)
def test_selection(selection: dict, selected: set[str]):
    topics = {"/worm/power", "/worm/tracker", "/rosout", "/worm/run_gait/_action/feedback"}
    chosen = TopicSelection(**selection)
    assert {topic for topic in topics if chosen.takes(topic)} == selected


@pytest.mark.parametrize("selection", [{}, {"regex": "("}, {"everything": True, "exclude": "*"}])
def test_empty_and_invalid_selections_are_rejected(selection: dict):
    with pytest.raises(BagError):
        TopicSelection(**selection)
