# SPDX-License-Identifier: Apache-2.0
"""worm_model.run has the constants of the messages, which it does not import."""

import pytest

from worm_model import run

messages = pytest.importorskip("worm_msgs.msg", reason="worm_msgs is not built")


def test_states_and_statuses_are_those_of_the_messages():
    for value, name in enumerate(run.STATE_NAMES):
        assert getattr(messages.GaitState, name.upper()) == value == getattr(run, name.upper())
    for value, name in enumerate(run.POWER_STATUS_NAMES):
        assert getattr(messages.Power, name.upper().replace(" ", "_")) == value
    assert messages.Power.VALID == run.POWER_VALID
