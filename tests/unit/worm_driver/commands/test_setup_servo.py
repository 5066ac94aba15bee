# SPDX-License-Identifier: Apache-2.0
"""Set-up of a new servo, byte for byte: interrupted after every write, and never of another servo."""

from random import Random

import pytest
from driver_rig import Bench

from worm_driver.commands.setup_servo import find_only_servo, main, set_up
from worm_driver.driver_errors import ConfigurationError, CorruptReplyError
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot import virtual_bus
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES, MODELS
from worm_driver.virtual_robot.servo.virtual_servo import Servo
from worm_driver.virtual_robot.wire.faults import FaultBoard
from worm_driver.virtual_robot.wire.packet import Instruction

#: a servo that another program used
USED = {"secondary_id": 3, "pwm_limit": 300, "min_position_limit": 1000, "velocity_limit": 50}


def servo(model: str = "XL430-W250", **eeprom: int) -> Servo:
    """Return a servo as it comes from the factory: id 1, 57600 bit/s, return delay 0.5 ms."""
    return Servo(MODELS[model], eeprom, 0.0, 0.25, Random(1))


def bench_of(*servos: Servo) -> Bench:
    return Bench(virtual_bus.ServoBus(servos, FaultBoard(), Random(1)).feed)


def run(bench: Bench, number: int = 11, baud_rate: int = 1_000_000) -> list[str]:
    lines: list[str] = []
    found = find_only_servo(bench.bus, lambda _: None)
    with bench.bus.retrying():
        set_up(bench.bus, found, number, baud_rate, lines.append)
    return lines


def registers(servo: Servo) -> dict[str, int]:
    names = ("id", "baud_rate", "return_delay_time", *USED, "max_position_limit", "shutdown")
    return {name: servo.memory[name] for name in names}


def expected(model: str) -> dict[str, int]:
    fresh = registers(servo(model))
    return {**fresh, "id": 11, "baud_rate": BAUD_RATES.index(1_000_000), "return_delay_time": 0}


@pytest.mark.parametrize("model", MODELS)
def test_a_new_and_a_used_servo_get_all_values(model):
    for eeprom in ({}, USED, {"id": 200, "baud_rate": 4, "homing_offset": 77}):
        target = servo(model, **eeprom)
        lines = run(bench_of(target))
        assert registers(target) == expected(model)
        assert target.memory["homing_offset"] == 0
        assert sum("verified" in line for line in lines) >= 3


def test_a_second_call_writes_nothing():
    target = servo(**USED)
    run(bench_of(target))
    again = bench_of(target)
    assert not any("->" in line for line in run(again))
    assert [packet.instruction for packet in again.written] == [Instruction.SYNC_WRITE]


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_that_answers_no_writes(level):
    target = servo()
    target.memory["status_return_level"] = level
    run(bench_of(target))
    assert registers(target) == expected("XL430-W250")


class PowerLost(BaseException):
    """The supply fails."""


def test_after_a_power_loss_after_any_write_the_next_call_finishes():
    interrupted = 0
    while True:
        target = servo(**USED)
        bench = bench_of(target)
        write, left = bench.bus.write, [interrupted]

        def limited(*arguments, write=write, left=left):
            if left[0] == 0:
                raise PowerLost
            left[0] -= 1
            write(*arguments)

        bench.bus.write = limited
        try:
            run(bench)
        except PowerLost:
            interrupted += 1
        else:
            break
        target.reboot(bench.clock.now)
        later = bench_of(target)
        later.clock.now = bench.clock.now + 1.0
        run(later)
        assert registers(target) == expected("XL430-W250"), interrupted
    assert interrupted == 7


def test_a_lost_answer_to_the_new_id_or_baud_rate_is_no_failure():
    target = servo()
    virtual = virtual_bus.ServoBus([target], FaultBoard(), Random(1))

    def receive(data: bytes, now: float, baud_rate: int):
        before = target.servo_id, target.memory["baud_rate"]
        answers = virtual.feed(data, now, baud_rate)
        return answers if before == (target.servo_id, target.memory["baud_rate"]) else []

    run(Bench(receive))
    assert registers(target) == expected("XL430-W250")


def test_a_value_that_is_not_stored_is_reported():
    bench = bench_of(servo())
    bench.bus.write = lambda *_: None
    with pytest.raises(CorruptReplyError, match="return_delay_time"):
        run(bench)


@pytest.mark.parametrize(
    ("others", "named"),
    [
        ([], "no servo"),
        ([servo(), servo(id=2)], "1 at 57600 bit/s, 2 at 57600"),
        ([servo(), servo(id=11, baud_rate=3)], "1 at 57600 bit/s, 11 at 1000000"),
    ],
)
def test_none_and_several_are_rejected_and_nothing_is_written(others, named):
    bench = bench_of(*others)
    with pytest.raises(ConfigurationError, match=named):
        run(bench)
    assert bench.written == []


def test_two_servos_with_one_id_and_a_servo_with_torque_are_rejected():
    bench = bench_of(servo(), servo())
    with pytest.raises(CorruptReplyError, match="1, 1"):
        run(bench)
    assert bench.written == []
    holding = servo()
    holding.memory["torque_enable"] = 1
    bench = bench_of(holding)
    with pytest.raises(ConfigurationError, match="torque"):
        run(bench)
    assert holding.memory["torque_enable"] == 1
    assert holding.servo_id == 1


@pytest.mark.parametrize(("answer", "status", "number"), [("y", 0, 11), ("n", 1, 1), (None, 1, 1)])
def test_the_command_asks_before_it_writes(monkeypatch, capsys, answer, status, number):
    target = servo()
    bench = bench_of(target)
    bench.bus.close = lambda: None
    monkeypatch.setattr(ServoBus, "open", lambda *_: bench.bus)

    def reply(_: str) -> str:
        if answer is None:
            raise EOFError
        return answer

    monkeypatch.setattr("builtins.input", reply)
    assert main(["11"]) == status
    assert target.servo_id == number
    assert ("nothing was written" in capsys.readouterr().out) == (answer != "y")
    assert main(["11", "--yes"]) == 0
    assert registers(target) == expected("XL430-W250")


def test_a_missing_port_is_a_failure_with_the_remedy(capsys, tmp_path):
    assert main(["11", "--port", str(tmp_path / "none")]) == 1
    assert "plug the adapter in" in capsys.readouterr().err
