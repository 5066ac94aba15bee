# SPDX-License-Identifier: Apache-2.0
"""Blocks of messages are merged as their messages would be, one by one."""

import heapq
from itertools import chain, pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from worm_model.bags.blocks import MessageBlock, block_of, block_of_topics, merge, merge_into
from worm_model.bags.payloads import groups, join, payloads_of

TIMES = st.integers(0, 6) | st.integers(0, 2**64 - 1)
Row = tuple[int, str, bytes, int]  # log time, topic, content, publish time


@st.composite
def rows(draw: st.DrawFn, mark: str = "", max_size: int = 12) -> list[Row]:
    """Messages by rising time, all different, of topics that other blocks may share."""
    times = sorted(draw(st.lists(TIMES, max_size=max_size)))
    return [
        (
            time,
            draw(st.sampled_from(["/x", "/y", f"/{mark}"])),
            draw(contents(mark, i)),
            draw(TIMES),
        )
        for i, time in enumerate(times)
    ]


def contents(mark: str, index: int) -> st.SearchStrategy[bytes]:
    return st.sampled_from([0, 1, 5, 40]).map(lambda size: f"{mark}{index}".encode().ljust(size))


def block(messages: list[Row]) -> MessageBlock:
    names = tuple(dict.fromkeys(topic for _, topic, _, _ in messages))
    return block_of(
        names,
        [names.index(topic) for _, topic, _, _ in messages],
        payloads_of([data for _, _, data, _ in messages], [time for time, _, _, _ in messages]),
        [publish_time for _, _, _, publish_time in messages],
    )


def unpacked(found: MessageBlock) -> list[Row]:
    topics = [found.names[index] for index in found.topic]
    times = found.log_time.tolist(), found.publish_time.tolist()
    return list(zip(times[0], topics, found.payloads.messages(), times[1], strict=True))


def by_time(row: Row) -> int:
    return row[0]


@given(rows("a", 30), rows("b", 20), st.lists(st.integers(0, 30)))
def test_a_block_goes_in_between_others_and_behind_their_equals(
    first: list[Row], second: list[Row], cuts: list[int]
):
    borders = [0, *sorted(min(cut, len(first)) for cut in cuts), len(first)]
    blocks = [block(first[a:b]) for a, b in pairwise(borders)]
    found = [row for part in merge_into(blocks, block(second)) for row in unpacked(part)]
    assert found == list(heapq.merge(first, second, key=by_time))


@given(st.lists(st.integers(0, 3).flatmap(lambda mark: rows("abcd"[mark])), max_size=6))
def test_blocks_that_overlap_become_blocks_that_do_not(parts: list[list[Row]]):
    parts = sorted((part for part in parts if part), key=lambda part: part[0][0])
    merged = list(merge((part[0][0], block(part)) for part in parts))
    assert [row for part in merged for row in unpacked(part)] == sorted(chain(*parts), key=by_time)
    assert all(len(part) for part in merged)


def test_what_is_pending_does_not_grow_with_the_number_of_blocks_that_overlap():
    """Neither its messages' bytes nor its topics' names."""
    parts = [[(t, f"/{t % 2}", bytes(1000), 0) for t in range(5 * k, 5 * k + 8)] for k in range(50)]
    for part in merge((rows[0][0], block(rows)) for rows in parts):
        assert len(part.names) <= 2
        assert len(part.payloads.buffer) <= 16_000


@given(st.lists(st.lists(TIMES, max_size=8), max_size=4))
def test_topics_become_a_block_in_which_equal_times_keep_the_topics_order(
    times: list[list[int]],
):
    topics = {
        f"/{k}": payloads_of([f"{k} {row}".encode() for row in range(len(column))], column)
        for k, column in enumerate(times)
    }
    expected = sorted(
        (time, k, row) for k, column in enumerate(times) for row, time in enumerate(column)
    )
    found = [(time, data.decode()) for time, _, data, _ in unpacked(block_of_topics(topics))]
    assert found == [(time, f"{k} {row}") for time, k, row in expected]
    assert join(list(topics.values())).messages() == [data.encode() for _, data in found]


@given(rows("a", 30))
def test_messages_by_topic(messages: list[Row]):
    found = {name: payloads.messages() for name, payloads in block(messages).by_topic()}
    assert found == {
        name: [data for _, topic, data, _ in messages if topic == name]
        for name in {topic for _, topic, _, _ in messages}
    }


@given(st.lists(st.integers(0, 3) | st.integers(0, 2**62)))
def test_groups_are_the_rows_of_each_value(keys: list[int]):
    found = {key: chosen.tolist() for key, chosen in groups(np.array(keys, dtype=np.int64))}
    assert list(found) == sorted(set(keys))
    assert found == {key: [i for i, other in enumerate(keys) if other == key] for key in set(keys)}
