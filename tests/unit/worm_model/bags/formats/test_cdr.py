# SPDX-License-Identifier: Apache-2.0
"""Columns of CDR messages against an independent encoder, message by message."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.cdr import MessageColumns, encode
from worm_model.bags.formats.cdr import decode as decode_block
from worm_model.bags.formats.message_block import Message, Topic, messages_of
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.run_writer import stamped_messages

STORE = get_typestore(Stores.ROS2_JAZZY)
FOLDER = Path(__file__).resolve().parents[5] / "src" / "worm_msgs" / "msg"
FILES = {f"worm_msgs/msg/{path.stem}": path for path in sorted(FOLDER.glob("*.msg"))}
for type_name, path in FILES.items():
    STORE.register(get_types_from_msg(path.read_text(), type_name))

TYPES = [
    *FILES,
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
]
BOUNDS = {
    **{f"int{b}": (-(2 ** (b - 1)), 2 ** (b - 1) - 1) for b in (8, 16, 32, 64)},
    **{f"uint{b}": (0, 2**b - 1) for b in (8, 16, 32, 64)},
    "byte": (0, 127),  # rosbags reads it as signed
}
TEXTS = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)


def decode(payloads: list[bytes], *topics: Topic) -> MessageColumns:
    """Return columns of messages, of each topic in turn if there are several."""
    channels = [topics[i % len(topics)] for i in range(len(payloads))]
    rows = zip(payloads, channels, strict=True)
    return decode_block(messages_of([Message(c.name, 0, data, 0, c) for data, c in rows]))


def bare(type_name: str, definition: str, kind: str = "ros2msg") -> Topic:
    return Topic("/x", type_name, 0, definition, kind, "cdr")


def base_values(base: str) -> st.SearchStrategy[Any]:
    if base == "string":
        return TEXTS
    if base == "bool":
        return st.booleans()
    if base.startswith("float"):
        return st.floats(width=int(base[5:]))
    return st.integers(*BOUNDS[base])


def values(description: Any) -> st.SearchStrategy[Any]:
    """Return messages as rosbags accepts them."""
    kind, argument = description
    if kind == Nodetype.BASE:
        return base_values(argument[0])
    if kind == Nodetype.NAME:
        return messages(argument)
    element, size = argument
    bounds = {"min_size": size, "max_size": size} if kind == Nodetype.ARRAY else {"max_size": 3}
    lists = st.lists(values(element), **bounds)
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        code = "uint8" if element[1][0] == "byte" else element[1][0]
        return lists.map(lambda items: np.array(items, dtype=code))
    return lists


def messages(type_name: str) -> st.SearchStrategy[Any]:
    fields = STORE.fielddefs[type_name][1]
    return st.builds(STORE.types[type_name], **{name: values(d) for name, d in fields})


def flat(value: Any, path: str = "") -> dict[str, Any]:
    """Return the leaves of a message by path; numbers of an array stay together."""
    if isinstance(value, list):
        found = {}
        for i, item in enumerate(value):
            found |= flat(item, f"{path}[{i}]")
        return found
    if hasattr(value, "__msgtype__"):
        found = {}
        for name, _ in STORE.fielddefs[value.__msgtype__][1]:
            found |= flat(getattr(value, name), f"{path}.{name}" if path else name)
        return found
    return {path: value}


def same(found: Any, expected: Any) -> bool:
    if isinstance(expected, str):
        return found == expected
    return np.array_equal(np.asarray(found), np.asarray(expected), equal_nan=True)


@pytest.mark.parametrize("type_name", TYPES)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_decoding_gives_what_an_independent_encoder_was_given(type_name: str, data):
    given_messages = data.draw(st.lists(messages(type_name), min_size=1, max_size=5))
    endian = data.draw(st.booleans())
    payloads = [
        bytes(STORE.serialize_cdr(message, type_name, little_endian=endian))
        for message in given_messages
    ]
    columns = decode(payloads, topic_of("/x", type_name))
    for row, message in enumerate(given_messages):
        for path, expected in flat(message).items():
            column = columns.texts[path] if isinstance(expected, str) else columns.numbers[path]
            assert same(column[row], expected), path


def test_encoded_columns_are_decoded_again_and_missing_fields_are_zero_or_empty():
    topic = topic_of("/x", "worm_msgs/msg/GaitState")
    strokes, texts = np.array([0.05, math.nan, 0.07]), ["", "cable servo 2: overload", ""]
    numbers = {
        "header.stamp.sec": np.array([1, 2, 3]),
        "gait.stroke": strokes,
        "gait.direction": -1,
    }
    columns = decode(encode(topic, 3, numbers, {"header.frame_id": "x", "message": texts}), topic)
    for path, values in numbers.items():
        np.testing.assert_array_equal(columns.numbers[path], values)
    others = [values for path, values in columns.numbers.items() if path not in numbers]
    assert len(others) > 10
    assert not np.any(others)
    assert columns.texts == {"header.frame_id": ["x"] * 3, "message": texts}


def test_a_stamp_from_before_the_epoch_is_rejected():
    with pytest.raises(BagError, match="before 1970"):
        stamped_messages(topic_of("/x", "worm_msgs/msg/Tracker"), np.array([5, -1]), {})


def test_a_field_that_the_type_lacks_is_rejected():
    for path in ("speed", "header.speed", "no.speed"):
        with pytest.raises(BagError, match=f"no field {path}"):
            encode(topic_of("/x", "worm_msgs/msg/Tracker"), 1, {path: 1.0}, {})


OLD = bare("a/msg/B", "float64 x\nint32 sec\n")
NEW = bare("a/msg/B", "float64 x\nuint32 run\nint32 sec\nfloat32[] more\n")


def old_and_new(count: int) -> list[bytes]:
    """Write messages of two layouts in turn."""
    old, new = (
        encode(topic, count, {"x": np.arange(count) + 0.5, "sec": 2**31 - 1}, {})
        for topic in (OLD, NEW)
    )
    return [(old, new)[i % 2][i] for i in range(count)]


def test_every_message_is_read_by_the_definition_of_its_own_channel():
    columns = decode(old_and_new(9), OLD, NEW)
    assert columns.numbers["x"].tolist() == [i + 0.5 for i in range(9)]
    assert columns.numbers["sec"].tolist() == [2**31 - 1] * 9
    assert columns.numbers["run"].tolist() == [0 if i % 2 else None for i in range(9)]


@pytest.mark.parametrize(("surplus", "rejected"), [(0, False), (3, False), (4, True), (8, True)])
def test_a_message_has_the_length_of_its_definition(surplus: int, rejected: bool):
    """Padding that a middleware may append is accepted."""
    (data,) = encode(OLD, 1, {}, {})
    complaint = rejection(lambda: decode([data + bytes(surplus)], OLD))
    assert bool(complaint) == rejected
    assert "shorter" in rejection(lambda: decode([data[:-1]], OLD))


def rejection(call: Callable[[], object]) -> str:
    """Return the message of a BagError, or an empty string without one; any other exception fails the test."""
    try:
        call()
    except BagError as error:
        return str(error)
    return ""


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=80), st.sampled_from(TYPES))
def test_random_bytes_are_decoded_or_rejected(data: bytes, type_name: str):
    assert "\n" not in rejection(lambda: decode([data], topic_of("/x", type_name)))


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=200) | st.binary(max_size=100).map(lambda b: b.decode("latin-1")))
def test_random_definitions_are_read_or_rejected(text: str):
    data = b"\0\1\0\0" + bytes(64)
    for kind in ("ros2msg", "ros2idl"):
        assert "\n" not in rejection(
            lambda kind=kind: decode([data], bare("a/msg/B", text or " ", kind))
        )
