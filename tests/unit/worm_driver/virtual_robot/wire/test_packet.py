# SPDX-License-Identifier: Apache-2.0
"""Packets of the virtual servos compared with the e-manual's vectors and with their own inverse."""

import pytest
from driver_rig import instruction_packet
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.virtual_robot.wire.packet import (
    HEADER,
    Instruction,
    InstructionReader,
    Packet,
    crc16,
    status_packet,
    stuff,
    unstuff,
)

# Bodies in which headers and half headers are likely.
tricky = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0xFE]), max_size=40).map(bytes)


@pytest.mark.parametrize(
    ("sent", "expected"),
    [
        (instruction_packet(1, Instruction.PING), "FFFFFD00010300 01 194E"),
        (status_packet(1, 0, bytes([0x06, 0x04, 0x26])), "FFFFFD00010700 55 00 060426 655D"),
        (
            instruction_packet(1, Instruction.READ, bytes([0x84, 0, 4, 0])),
            "FFFFFD00010700 02 84000400 1D15",
        ),
        (instruction_packet(1, Instruction.REBOOT), "FFFFFD00010300 08 2F4E"),
    ],
)
def test_the_manuals_packets(sent, expected):
    assert sent == bytes.fromhex(expected)


@given(tricky)
def test_stuffing_has_an_inverse_and_leaves_no_header(body):
    stuffed = stuff(body)
    assert unstuff(stuffed) == body
    assert HEADER + b"\x00" not in stuffed


@given(st.binary(max_size=40))
def test_a_packet_with_its_checksum_behind_it_leaves_no_remainder(data):
    # A property of every CRC without final xor, independent of the table.
    assert crc16(data + crc16(data).to_bytes(2, "big")) == 0


@given(st.lists(tricky, min_size=1, max_size=4), st.binary(max_size=6), st.data())
def test_packets_are_found_however_the_stream_is_cut(bodies, noise, data):
    stream = noise.replace(b"\xff", b"\x00") + b"".join(
        instruction_packet(7, Instruction.WRITE, body) for body in bodies
    )
    reader = InstructionReader(allowed_gap=1.0)
    found = []
    while stream:
        length = data.draw(st.integers(1, len(stream)))
        found += reader.feed(stream[:length], 0.0)
        stream = stream[length:]
    assert [packet.parameters for packet in found] == bodies


def test_an_unstuffed_header_in_a_body_loses_the_packet_but_not_the_next():
    body = bytes([Instruction.WRITE, 0x74, 0x00]) + HEADER + b"\xff"  # goal -131073, not stuffed
    head = HEADER + b"\x00\x01" + (len(body) + 2).to_bytes(2, "little")
    packet = head + body + crc16(head + body).to_bytes(2, "little")
    ping = instruction_packet(1, Instruction.PING)
    assert InstructionReader(1.0).feed(packet + ping, 0.0) == [Packet(1, Instruction.PING, b"")]
