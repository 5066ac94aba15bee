# SPDX-License-Identifier: Apache-2.0
"""worm_model.run has the constants of the messages, which it does not import."""

from worm_model import run
from worm_msgs import msg as messages


def test_states_and_statuses_are_those_of_the_messages():
    for activity in run.Activity:
        assert getattr(messages.GaitState, activity.name) == activity
        assert run.state_name(activity) == activity.name.lower()
    assert run.state_name(17) == "state 17"
    for source in run.LengthSource:
        assert getattr(messages.BodyLength, source.name) == source
    for value, name in enumerate(run.POWER_STATUS_NAMES):
        assert getattr(messages.Power, name.upper().replace(" ", "_")) == value
    assert messages.Power.VALID == run.POWER_VALID
