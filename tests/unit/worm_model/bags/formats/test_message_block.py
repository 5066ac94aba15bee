# SPDX-License-Identifier: Apache-2.0
"""Blocks of messages hold what single messages hold."""

from hypothesis import given
from hypothesis import strategies as st

from worm_model.bags.formats.message_block import Message, Topic, concatenate, messages_of

TIMES = st.integers(0, 6) | st.integers(0, 2**64 - 1)
TOPICS = [Topic(name, "a/msg/B", 0, f"# {i}", "ros2msg", "cdr") for i, name in enumerate("xyx")]
MESSAGES = st.lists(
    st.builds(
        lambda topic, time, data, sent: Message(topic.name, time, data, sent, topic),
        st.sampled_from(TOPICS),
        TIMES,
        st.binary(max_size=5),
        TIMES,
    ),
    min_size=1,
    max_size=12,
)


@given(MESSAGES)
def test_messages_are_what_they_were_put_together_from(messages):
    block = messages_of(messages)
    assert list(block) == messages
    assert list(block.compact()) == messages
    assert list(block.sorted()) == sorted(messages, key=lambda m: m.log_time)
    assert list(concatenate([block, block.sorted()])) == [*block, *block.sorted()]
    by_topic = {name: list(part) for name, part in block.by_topic()}
    assert by_topic == {
        name: [m for m in messages if m.topic == name] for name in {m.topic for m in messages}
    }
