# SPDX-License-Identifier: Apache-2.0
"""The worm's topics are recognised by the end of their names."""

import pytest
import yaml
from interfaces_page import rows_of

from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.worm_topics import JOINT_STATE, TYPES, find_topic, offered_qos


def test_the_twins_joints_are_not_mistaken_for_the_robots():
    names = "/worm/twin/joint_states", "/worm/joint_states"
    both = [topic_of(name, JOINT_STATE) for name in names]
    robot, twin = find_topic(both, "joint_states"), find_topic(both, "twin/joint_states")
    assert robot == both[1]
    assert twin == both[0]


@pytest.mark.parametrize("name", TYPES)
def test_written_topics_have_the_quality_of_service_of_the_nodes(name: str):
    """The documentation is compared with the running nodes by an integration test."""
    (profile,) = yaml.safe_load(offered_qos(name))
    documented = rows_of("Topics")[name][3]
    assert profile["reliability"] == "reliable"  # as the page states of all publishers
    assert (profile["durability"] == "transient_local") == ("transient local" in documented)
