# SPDX-License-Identifier: Apache-2.0
"""Replacement of smbus2.SMBus, through its socket."""

import errno
import socket
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.power.socket_smbus import (
    Answer,
    Request,
    SocketSMBus,
    pack_answer,
    pack_request,
    unpack_answer,
    unpack_request,
)
from worm_driver.virtual_robot.wire.faults import make_fault

ADDRESS = 0x40
byte = st.integers(0, 255)


@pytest.fixture
def served(serve):
    return serve(1.0)


@pytest.fixture
def bus(served):
    with closing(SocketSMBus(served.socket)) as bus:
        yield bus


def test_a_16_bit_value_is_low_byte_first_and_a_wrong_address_a_nack(bus):
    bus.write_word_data(ADDRESS, 5, 0x6210)
    assert bus.read_word_data(ADDRESS, 5) == 0x6210
    with pytest.raises(OSError) as caught:
        bus.read_word_data(0x41, 0)
    assert caught.value.errno == errno.EREMOTEIO
    assert bus.read_word_data(ADDRESS, 0) == 0x9F39


def test_a_hanging_bus_is_a_timeout(bus, served):
    served.server.inject(make_fault("i2c_timeout", value=0.05))
    seen = []
    while not seen:
        try:
            bus.read_word_data(ADDRESS, 0)
        except OSError as error:
            seen.append(error.errno)
    assert seen == [errno.ETIMEDOUT]


def test_a_robot_that_is_gone_is_an_input_output_error(bus, served):
    served.end()
    with pytest.raises(OSError) as caught:
        bus.read_word_data(ADDRESS, 0)
    assert caught.value.errno == errno.EIO


def test_a_closed_bus_is_reported(bus):
    bus.close()
    bus.close()
    with pytest.raises(OSError) as caught:
        bus.read_word_data(ADDRESS, 0)
    assert caught.value.errno == errno.EBADF


@given(byte, byte, byte, st.binary(max_size=32))
def test_packets_have_an_inverse(operation, address, register, data):
    request = Request(operation, address, register, data)
    assert unpack_request(pack_request(request)) == request
    answer = Answer(operation, data)
    assert unpack_answer(pack_answer(answer)) == answer


def test_a_packet_that_is_no_request_ends_its_connection(served):
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)) as stranger:
        stranger.connect(served.socket)
        stranger.send(b"x")
        assert stranger.recv(1) == b""
