# SPDX-License-Identifier: Apache-2.0
"""The servo bus on a virtual clock: which servo responds, when, and with which bytes."""

import pytest
from driver_rig import instruction_packet
from hypothesis import example, given
from hypothesis import strategies as st

from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_driver.virtual_robot.wire.faults import FaultBoard, make_fault
from worm_driver.virtual_robot.wire.packet import (
    ALERT,
    BROADCAST_ID,
    Instruction,
    status_packet,
)

CABLE, REAR, FRONT = 1, 11, 12
PING = instruction_packet(CABLE, Instruction.PING)
PONG = status_packet(CABLE, 0, bytes([0xFC, 0x03, 48]))
SETTINGS = load_settings()


def robot(*requests):
    return VirtualRobot(SETTINGS, FaultBoard(requests))


def two_bytes(value):
    return value.to_bytes(2, "little")


def read(servo, address, length):
    return instruction_packet(servo, Instruction.READ, two_bytes(address) + two_bytes(length))


def write(servo, address, data):
    return instruction_packet(servo, Instruction.WRITE, two_bytes(address) + data)


def replies(virtual, data, time=0.0):
    return [answer.data for answer in virtual.receive(data, time)]


def test_a_broadcast_ping_is_answered_in_the_order_of_ids():
    answers = replies(robot(), instruction_packet(BROADCAST_ID, Instruction.PING))
    assert [answer[4] for answer in answers] == [CABLE, REAR, FRONT]


def test_a_sync_read_is_answered_in_the_order_of_the_request():
    request = instruction_packet(
        BROADCAST_ID, Instruction.SYNC_READ, two_bytes(0) + two_bytes(2) + bytes([FRONT, 7, CABLE])
    )
    assert replies(robot(), request) == [
        status_packet(FRONT, 0, two_bytes(1060)),
        status_packet(CABLE, 0, two_bytes(1020)),
    ]


@pytest.mark.parametrize("missing", [0, 1, 4])
def test_a_sync_write_with_a_part_that_is_cut_off_writes_nothing(missing):
    virtual = robot()
    items = [bytes([servo]) + b"\x07\0\0\0" for servo in (CABLE, REAR)]
    data = two_bytes(108) + two_bytes(4) + b"".join(items)
    data = data[: len(data) - missing]
    replies(virtual, instruction_packet(BROADCAST_ID, Instruction.SYNC_WRITE, data))
    written = [servo.memory["profile_acceleration"] for servo in virtual.servos[:2]]
    assert written == ([0, 0] if missing else [7, 7])


@pytest.mark.parametrize("instruction", [Instruction.READ, Instruction.REBOOT + 1, 0x55, 0xA0])
def test_no_servo_answers_a_broadcast_of_another_instruction(instruction):
    assert replies(robot(), instruction_packet(BROADCAST_ID, instruction, b"\0\0\2\0")) == []


@pytest.mark.parametrize(
    ("request_bytes", "number"),
    [
        (instruction_packet(CABLE, 0x77), 2),
        (PING[:-1] + bytes([PING[-1] ^ 1]), 3),
        (instruction_packet(CABLE, Instruction.READ, b"\0\0"), 5),
        (instruction_packet(CABLE, Instruction.WRITE, b"\0"), 5),
        (read(CABLE, 160, 20), 7),
        (write(CABLE, 132, bytes(4)), 7),
    ],
)
def test_the_number_of_each_error(request_bytes, number):
    assert replies(robot(), request_bytes) == [status_packet(CABLE, number)]


@pytest.mark.parametrize(("level", "answered"), [(0, "p"), (1, "pr"), (2, "prw")])
def test_the_status_return_level(level, answered):
    virtual = robot()
    virtual.receive(write(CABLE, 68, bytes([level])), 0.0)
    requests = {"p": PING, "r": read(CABLE, 7, 1), "w": write(CABLE, 65, b"\x01")}
    assert [key for key, data in requests.items() if replies(virtual, data)] == list(answered)


def test_an_answer_carries_the_id_from_before_its_change():
    virtual = robot()
    assert replies(virtual, write(CABLE, 7, b"\x05")) == [status_packet(CABLE, 0)]
    assert replies(virtual, PING) == []
    assert replies(virtual, instruction_packet(5, Instruction.PING)) != []


def test_the_return_delay_is_two_microseconds_a_count():
    virtual = robot()
    virtual.receive(write(CABLE, 9, b"\xfa"), 0.0)
    (answer,) = virtual.receive(PING, 1.0)
    assert answer.time == pytest.approx(1.0005)


def test_the_wrong_rate_gets_no_answer():
    virtual = robot()
    assert virtual.receive(PING, 0.0, 57600) == []
    assert len(virtual.receive(PING, 0.0, 1_000_000)) == 1


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_sync_read_resets_the_watchdog_also_of_a_servo_that_does_not_answer(level):
    virtual = robot()
    virtual.receive(write(CABLE, 64, b"\x01"), 0.0)
    virtual.receive(write(CABLE, 98, b"\x05"), 0.0)  # 100 ms
    virtual.receive(write(CABLE, 68, bytes([level])), 0.0)
    parameters = two_bytes(132) + two_bytes(4) + bytes([CABLE])
    request = instruction_packet(BROADCAST_ID, Instruction.SYNC_READ, parameters)
    for tick in range(1, 21):
        virtual.advance(tick * 0.05)
        assert len(replies(virtual, request, tick * 0.05)) == (level > 0)
    assert virtual.servos[0].memory["bus_watchdog"] == 5
    for tick in range(1, 21):  # packets for another servo do not reset it
        virtual.receive(instruction_packet(REAR, Instruction.PING), 1.0 + tick * 0.01)
    assert virtual.servos[0].memory["bus_watchdog"] == -1


def test_fuzzed_answers_are_of_all_kinds_and_repeat_with_the_seed():
    def fuzzed():
        virtual = robot(make_fault("fuzzed", duration=10.0))
        return [answer for _ in range(100) for answer in replies(virtual, PING)]

    answers = fuzzed()
    assert len(set(answers)) > 50
    assert {len(answer) < len(PONG) for answer in answers} == {True, False}
    assert answers == fuzzed()


def test_what_follows_a_late_answer_is_late_too():
    virtual = robot(make_fault("late", target=CABLE, value=0.3))
    late, next_one = [virtual.receive(PING, time)[0] for time in (1.0, 1.1)]
    assert late.time == pytest.approx(1.3)
    assert next_one.time == pytest.approx(1.3)
    assert virtual.receive(PING, 1.4)[0].time == 1.4


@pytest.mark.parametrize(
    ("name", "bit", "shuts_down"),
    [("overload", 5, True), ("overheating", 2, True), ("input_voltage", 0, False)],
)
def test_hardware_alerts_last_until_a_reboot(name, bit, shuts_down):
    virtual = robot(make_fault(name, target=CABLE, start=1.0))
    virtual.receive(write(CABLE, 64, b"\x01"), 0.5)
    assert replies(virtual, read(CABLE, 70, 1), 3.0) == [
        status_packet(CABLE, ALERT, bytes([1 << bit]))
    ]
    assert virtual.servos[0].memory["torque_enable"] == (not shuts_down)
    torque_on = replies(virtual, write(CABLE, 64, b"\x01"), 3.1)
    assert torque_on == [status_packet(CABLE, ALERT | shuts_down)]
    reboot = instruction_packet(CABLE, Instruction.REBOOT)
    assert len(replies(virtual, reboot, 3.2)) == 1
    assert replies(virtual, PING, 3.4) == []  # the servo boots
    assert replies(virtual, write(CABLE, 64, b"\x01"), 4.0) == [status_packet(CABLE, 0)]


@given(st.lists(st.binary(max_size=30), max_size=8), st.integers(0, 2**32))
def test_rubbish_never_disturbs_what_follows(rubbish, tail):
    virtual = robot()
    for index, data in enumerate(rubbish):
        virtual.receive(data, index * 0.001)
    virtual.receive(b"\xff\xff\xfd\x00\x01" + tail.to_bytes(5, "little"), 0.01)
    # After a pause, old bytes on the bus have no effect.
    assert replies(virtual, PING, 0.2) == [PONG]


@given(
    st.sampled_from([CABLE, REAR, BROADCAST_ID, 77]), st.integers(0, 255), st.binary(max_size=24)
)
# more than the control table
@example(BROADCAST_ID, Instruction.SYNC_READ, b"\x00\x00\xff\xff\x01")
def test_any_instruction_gets_valid_answers(servo, instruction, parameters):
    virtual = robot()
    for answer in replies(virtual, instruction_packet(servo, instruction, parameters)):
        assert answer[:4] == b"\xff\xff\xfd\x00"
        assert len(answer) == 7 + int.from_bytes(answer[5:7], "little")
    virtual.advance(0.02)
