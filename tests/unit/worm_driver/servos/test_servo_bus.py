# SPDX-License-Identifier: Apache-2.0
"""The bus against byte-level servos. Each fault of the SDK has a test that fails without its remedy."""

import random
import threading
import time

import pytest
from driver_rig import CABLE, Clock, Line, SimulatedPort, Wire
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.driver_errors import (
    BusError,
    ConfigurationError,
    CorruptReplyError,
    NoReplyError,
    PortError,
    StatusError,
)
from worm_driver.servos.registers import COMMON, Register
from worm_driver.servos.servo_bus import Identity, ServoBus
from worm_driver.servos.state_reader import STATE_SIZE, STATE_START
from worm_driver.virtual_robot.wire.packet import InstructionReader, status_packet

GOAL = COMMON["goal_position"]
POSITION = COMMON["present_position"]
MODEL = COMMON["model_number"]


@pytest.fixture
def line() -> Line:
    return Line()


def errors(line: Line) -> dict[int, int]:
    replies = line.bus.sync_read(STATE_START, STATE_SIZE, [1, 11, 12])[1]
    return {servo: reply.error for servo, reply in replies.items()}


# --- the protocol --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "sent"),
    [
        (lambda bus: bus.ping(1), "FFFFFD00010300 01 194E"),
        (lambda bus: bus.read(1, POSITION), "FFFFFD00010700 02 8400 0400 1D15"),
        (lambda bus: bus.reboot(1), "FFFFFD00010300 08 2F4E"),
    ],
    ids=["ping", "read", "reboot"],
)
def test_a_request_is_the_manuals(line, request_, sent):
    answer = request_(line.bus)
    assert line.wire.sent[0] == bytes.fromhex(sent)
    assert not isinstance(answer, Identity) or answer == Identity(1020, 48)


def test_torque_off_needs_no_answer(line):
    torque = COMMON["torque_enable"]
    for servo in (1, 11, 12):
        line.bus.write(servo, torque, 1)
    line.inject("no_answer", duration=100.0)
    line.bus.torque_off_all()
    line.robot.board.clear()
    assert [line.bus.read(servo, torque) for servo in (1, 11, 12)] == [0, 0, 0]


# --- stuffing that the SDK drops ----------------------------------------------------------------


def test_a_sync_write_with_a_header_in_it_arrives(line):
    """The SDK sends it unstuffed, and a servo reads the header as the start of another packet."""
    assert b"\xff\xff\xfd" in GOAL.pack(-131073)
    line.bus.sync_write(GOAL, {1: -131073, 11: 5})
    assert len(line.wire.sent) == 1
    assert (line.bus.read(1, GOAL), line.bus.read(11, GOAL)) == (-131073, 5)


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00]), min_size=4, max_size=4).map(bytes))
def test_an_answer_with_headers_in_it_is_read_whole(data):
    clock = Clock()
    wire = Wire(clock, lambda _, now: [(now, status_packet(1, 0, data))])
    bus = ServoBus(SimulatedPort(wire, clock))
    register = Register("four_bytes", 132, 4)
    assert bus.read(1, register) == int.from_bytes(data, "little")


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x01]), max_size=40).map(bytes))
def test_what_is_sent_is_what_a_receiver_unstuffs(data):
    seen = []
    reader = InstructionReader(1.0)
    clock = Clock()

    def answer(sent, now):
        seen.extend(reader.feed(sent, now))
        return [(now, status_packet(1, 0))]

    bus = ServoBus(SimulatedPort(Wire(clock, answer), clock))
    register = Register("many", 0, max(1, len(data)))
    bus.write(1, register, int.from_bytes(data or b"\0", "little"))
    (packet,) = seen
    assert packet.intact
    assert packet.parameters[2:] == (data or b"\0")


# --- late, lost, garbled and doubled responses ----------------------------------------------------


def test_a_late_answer_is_not_mistaken_for_the_next_one(line):
    """The response with the model number is late; the SDK returns it for the next request of the same length."""
    line.inject("late", count=1, value=0.006)
    bus = ServoBus(line.port, retries=0)
    with pytest.raises(NoReplyError):
        bus.read(1, MODEL)
    voltage = COMMON["present_input_voltage"]
    assert bus.read(1, voltage) == pytest.approx(120, abs=1)


@pytest.mark.parametrize("fault", ["no_answer", "corrupted_crc", "truncated", "late"])
def test_one_bad_answer_is_repaired_by_a_repetition(line, fault):
    line.inject(fault, count=1, value=0.006)
    assert line.bus.read(1, MODEL) == 1020
    assert line.bus.counters.retries == 1


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        ("no_answer", NoReplyError),
        ("corrupted_crc", CorruptReplyError),
        ("truncated", CorruptReplyError),
    ],
)
def test_the_retry_budget_is_kept(line, fault, error):
    line.inject(fault, duration=100.0)
    bus = ServoBus(line.port, retries=2)
    with pytest.raises(error, match="servo 1"):
        bus.read(1, MODEL)
    assert len(line.wire.sent) == 3


def test_an_answer_of_another_length_is_none():
    clock = Clock()
    stale, right = status_packet(1, 0, b"\x01\x02\x03\x04"), status_packet(1, 0, b"\x78\x00")
    answers = iter([stale, right])
    bus = ServoBus(SimulatedPort(Wire(clock, lambda _, now: [(now, next(answers))]), clock))
    assert bus.read(1, COMMON["present_input_voltage"]) == 120


def test_two_servos_with_one_id_are_a_possible_cause_of_garbled_answers(line):
    """Both transmit at once: the line is low if one of them pulls it low."""

    def collide(data, now):
        (answer,) = line.robot.receive(data, now)
        other = status_packet(1, 0, (4711).to_bytes(4, "little"))
        return [(now, bytes(a & b for a, b in zip(answer.data, other, strict=True)))]

    line.wire._answer = collide
    with pytest.raises(CorruptReplyError, match="no other servo has its id"):
        line.bus.read(1, POSITION)


def test_bytes_that_keep_coming_do_not_hang_the_bus():
    """The SDK checks its timeout only when bytes are missing."""
    clock = Clock()
    rubbish = random.Random(1)

    def babble(_, now):
        return [(now + i * 0.0001, rubbish.randbytes(20)) for i in range(10_000)]

    bus = ServoBus(SimulatedPort(Wire(clock, babble), clock), retries=0)
    with pytest.raises(BusError):
        bus.read(1, MODEL)
    assert clock.now < 0.1


# --- errors that the SDK's sync read drops --------------------------------------------------------


def test_only_a_garbled_request_is_repeated(line):
    line.inject("error", count=1, value=3)
    assert line.bus.read(1, MODEL) == 1020
    line.inject("error", count=1, value=4)
    with pytest.raises(StatusError, match="servo 1 ") as caught:
        line.bus.read(1, MODEL)
    assert caught.value.number == 4


@pytest.mark.parametrize("number", range(1, 8))
def test_a_sync_read_keeps_each_servos_error(line, number):
    line.inject("error", target=11, count=1, value=number)
    assert errors(line) == {1: 0, 11: number, 12: 0}


def test_a_sync_read_keeps_the_alert_bit_which_hides_no_error_number(line):
    line.inject("overload", target=12)
    line.robot.advance(0.1)
    line.clock.now = 0.1
    replies = line.bus.sync_read(STATE_START, STATE_SIZE, [1, 11, 12])[1]
    assert {servo for servo, reply in replies.items() if reply.alert} == {12}
    line.inject("error", target=12, count=1, value=4)
    with pytest.raises(StatusError) as caught:
        line.bus.read(12, MODEL)
    assert caught.value.number == 4


# --- the port ------------------------------------------------------------------------------------


def test_a_baud_rate_that_the_sdk_cannot_set_is_rejected(terminal):
    with pytest.raises(ConfigurationError, match="4500000"):
        ServoBus.open(terminal, 4_500_000)


def test_waiting_costs_no_processor_time(terminal):
    """The SDK polls: 200 ms of waiting would be 200 ms of a core."""
    bus = ServoBus.open(terminal, 1_000_000, latency=0.1, retries=0)
    before = time.thread_time()
    with pytest.raises(NoReplyError):
        bus.ping(1)
    assert time.thread_time() - before < 0.05
    bus.close()


def test_a_step_of_the_wall_clock_does_not_shorten_a_wait(line, monkeypatch):
    """The SDK measures by time.time(): a jump forward would end the wait before the response."""
    jumps = iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: next(jumps) * 3600.0)
    assert line.bus.read(1, MODEL) == 1020
    assert line.bus.counters.timeouts == 0


def test_an_exception_in_an_exchange_leaves_the_bus_usable(line):
    """Otherwise the SDK's busy flag would remain set, and every later call fail with COMM_PORT_BUSY."""
    line.bus.ping(1)
    line.wire.unplugged = True
    with pytest.raises(PortError, match="is gone"):
        line.bus.ping(1)
    line.wire.unplugged = False
    assert line.bus.ping(1).model_number == 1020


def test_two_threads_do_not_get_into_each_others_way(line):
    """The SDK's flag is no lock: one of two threads would get COMM_PORT_BUSY."""
    found: list[object] = []

    def read_servo(servo: int) -> None:
        for _ in range(200):
            try:
                found.append(line.bus.ping(servo).model_number)
            except BusError as error:
                found.append(error)

    threads = [threading.Thread(target=read_servo, args=(servo,)) for servo in (1, 11)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(map(str, found)) == ["1020"] * 200 + ["1060"] * 200


def test_a_full_output_buffer_is_an_error_and_no_hang(terminal):
    """The other end is not read: the kernel's buffer fills, and a plain write would wait forever."""
    bus = ServoBus.open(terminal, 1_000_000)

    def write_on() -> None:
        for _ in range(2000):
            bus.sync_write(GOAL, dict.fromkeys(range(1, 50), 0))

    with pytest.raises(PortError):
        write_on()
    bus.close()


# --- ten thousand packets -------------------------------------------------------------------------


def test_ten_thousand_fuzzed_packets_give_the_truth_or_an_error(line):
    bus, outcomes = ServoBus(line.port, retries=0), {"value": 0, "error": 0}
    bus.write(CABLE, GOAL, -131073)
    line.inject("fuzzed", duration=1e6)
    for _ in range(10_000):
        try:
            assert bus.read(CABLE, GOAL) == -131073
            outcomes["value"] += 1
        except BusError:
            outcomes["error"] += 1
    assert outcomes["value"] > 500
    assert outcomes["error"] > 2000


def test_noise_is_never_an_answer():
    dice, clock = random.Random(42), Clock()
    wire = Wire(clock, lambda _, now: [(now, dice.randbytes(dice.randrange(60)))])
    bus = ServoBus(SimulatedPort(wire, clock), retries=0)
    for _ in range(1000):
        with pytest.raises(BusError):
            bus.ping(1)
