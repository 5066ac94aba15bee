# SPDX-License-Identifier: Apache-2.0
"""MCAP files of numbers, by the `mcap` library."""

import struct
from collections.abc import Iterable
from io import BytesIO
from typing import Any

from mcap.writer import Writer

TYPE, DEFINITION = "std_msgs/msg/UInt64", "uint64 data\n"


def payload(value: int) -> bytes:
    return b"\x00\x01\x00\x00" + struct.pack("<Q", value)


def mcap_bytes(
    topics: Iterable[str], rows: Iterable[tuple[str, int, int, int]], **options: Any
) -> bytes:
    """Return a file with metadata, an attachment, and rows of topic, value, log time and publish time.

    ``options`` are those of the library's writer.
    """
    stream = BytesIO()
    writer = Writer(stream, **options)
    writer.start("ros2")
    schema = writer.register_schema(TYPE, "ros2msg", DEFINITION.encode())
    channels = {topic: writer.register_channel(topic, "cdr", schema) for topic in topics}
    writer.add_metadata("worm_run", {"seed": "4"})
    writer.add_attachment(0, 0, "parameters.yaml", "application/yaml", b"pitch: 0.0173\n")
    for topic, value, log_time, publish_time in rows:
        writer.add_message(channels[topic], log_time, payload(value), publish_time)
    writer.finish()
    return stream.getvalue()
