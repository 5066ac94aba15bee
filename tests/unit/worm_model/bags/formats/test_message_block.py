# SPDX-License-Identifier: Apache-2.0
"""Merging blocks of messages gives the same order as merging single messages."""

from collections import Counter
from itertools import chain, pairwise

from hypothesis import given
from hypothesis import strategies as st

from worm_model.bags.formats.message_block import Message, Topic, merge, messages_of

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
    assert [block.payload(row) for row in range(len(block))] == [m.data for m in messages]
    assert list(block.sorted()) == sorted(messages, key=lambda m: m.log_time)
    by_topic = {name: list(part) for name, part in block.by_topic()}
    assert by_topic == {
        name: [m for m in messages if m.topic == name] for name in {m.topic for m in messages}
    }


@given(st.lists(MESSAGES, max_size=6))
def test_merging_gives_the_messages_by_rising_time(parts):
    parts.sort(key=lambda part: min(m.log_time for m in part))
    blocks = [(min(m.log_time for m in part), messages_of(part)) for part in parts]
    merged = list(merge(blocks))
    assert all(len(block) for block in merged)
    found = list(chain(*merged))
    assert Counter(found) == Counter(chain(*parts))
    assert found == sorted(chain(*parts), key=lambda m: m.log_time)
    for before, after in pairwise(merged):
        assert before.log_time[-1] <= after.log_time[0]
