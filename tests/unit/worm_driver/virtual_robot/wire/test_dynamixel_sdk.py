# SPDX-License-Identifier: Apache-2.0
"""The servo bus behind its pseudo-terminal, accessed with the real SDK."""

import select
import termios
import time
from collections.abc import Iterator

import dynamixel_sdk
import pytest
import serial
from dynamixel_sdk import (
    COMM_SUCCESS,
    GroupBulkRead,
    GroupSyncRead,
    PacketHandler,
    PortHandler,
)

from worm_driver.virtual_robot.wire import faults
from worm_driver.virtual_robot.wire.faults import make_fault

CABLE, REAR, FRONT = 1, 11, 12
POSITION, BLOCK = 132, 126


class WaitingPort(PortHandler):
    """The SDK's port without polling, so that the serving thread gets to run."""

    def readPort(self, length):
        remaining = (self.packet_timeout - self.getTimeSinceStart()) / 1000
        if length <= 0 or remaining <= 0 or not select.select([self.ser], [], [], remaining)[0]:
            return b""
        return super().readPort(length)


def set_timeout(monkeypatch, seconds):
    """Set the time that the SDK waits for a response."""
    monkeypatch.setattr(dynamixel_sdk.port_handler, "LATENCY_TIMER", seconds * 500)


@pytest.fixture
def port(served, monkeypatch) -> Iterator[PortHandler]:
    set_timeout(monkeypatch, 5.0)  # only a failing test waits so long
    handler = WaitingPort(served.port)
    assert handler.openPort()
    assert handler.setBaudRate(1_000_000)
    yield handler
    handler.closePort()


@pytest.fixture
def sdk() -> PacketHandler:
    return PacketHandler(2.0)


def wait_until(condition, what):
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline, f"no {what} within 10 s"


def inject(served, name, **options):
    """Request a fault and wait until the serving thread has accepted the request."""
    fault = make_fault(name, **options)
    served.server.inject(fault)
    board, now = served.robot.board, served.server.now
    wait_until(lambda: board.active(name, now(), fault.target), f"fault {name}")


def test_a_broadcast_ping_finds_all(port, sdk):
    found, result = sdk.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {CABLE: [1020, 48], REAR: [1060, 47], FRONT: [1060, 47]}


@pytest.mark.parametrize("method", ["txRxPacket", "fastSyncRead"])
def test_one_read_of_all_servos(port, sdk, method):
    read = GroupSyncRead(port, sdk, BLOCK, 21)
    for servo in (CABLE, REAR, FRONT):
        assert read.addParam(servo)
    assert getattr(read, method)() == COMM_SUCCESS
    for servo in (CABLE, REAR, FRONT):
        alone, _, _ = sdk.read4ByteTxRx(port, servo, POSITION)
        assert read.getData(servo, POSITION, 4) == alone
        assert read.getData(servo, 144, 2) in (119, 120)


@pytest.mark.parametrize("method", ["txRxPacket", "fastBulkRead"])
def test_a_bulk_read(port, sdk, method):
    read = GroupBulkRead(port, sdk)
    read.addParam(CABLE, 0, 2)
    read.addParam(REAR, 144, 2)
    assert getattr(read, method)() == COMM_SUCCESS
    assert read.getData(CABLE, 0, 2) == 1020
    assert read.getData(REAR, 144, 2) in (119, 120)


def test_unplugged_and_plugged_in_again(served, sdk):
    handler = WaitingPort(served.port)
    handler.openPort()
    inject(served, faults.UNPLUGGED, duration=0.3)
    # Not an OSError where the SDK clears the line: a driver has to catch both.
    with pytest.raises((serial.SerialException, termios.error)):
        sdk.ping(handler, CABLE)
    handler.closePort()
    wait_until(lambda: (served.directory / "servo_bus").exists(), "port")
    again = WaitingPort(served.port)
    assert again.openPort()
    assert sdk.ping(again, CABLE)[1] == COMM_SUCCESS
    again.closePort()
