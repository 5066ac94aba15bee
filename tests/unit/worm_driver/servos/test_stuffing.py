# SPDX-License-Identifier: Apache-2.0
from dynamixel_sdk import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos.stuffing import stuff, unstuff
from worm_driver.virtual_robot.wire.packet import stuff as independent_stuff

#: bodies rich in headers
BODIES = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55]), max_size=60).map(bytes)


@given(BODIES)
def test_stuffing_is_undone_by_unstuffing(body):
    assert unstuff(stuff(body)) == body


@given(BODIES)
def test_a_stuffed_body_holds_no_header(body):
    stuffed = stuff(body)
    for i in range(len(stuffed) - 3):
        assert stuffed[i : i + 3] != b"\xff\xff\xfd" or stuffed[i + 3] == 0xFD
    assert stuffed == independent_stuff(body)


def _status(body: bytes) -> list[int]:
    length = len(body) + 2
    return [0xFF, 0xFF, 0xFD, 0, 1, length & 0xFF, length >> 8, *body, 0, 0]


def test_the_sdk_loses_a_byte_where_this_does_not():
    """The fault that _PacketHandler.removeStuffing mends; when this fails, the SDK has been mended."""
    body = b"\x55\x00\xff\xff\xfd\xff\xfd\xfd"
    packet = Protocol2PacketHandler().removeStuffing(_status(stuff(body)))
    length = packet[5] | packet[6] << 8
    assert bytes(packet[7 : 7 + length - 2]) != body
    assert unstuff(stuff(body)) == body
