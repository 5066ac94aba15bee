# SPDX-License-Identifier: Apache-2.0
"""The calibration: its arithmetic, and a whole dialogue with the virtual robot's servos."""

import math
from dataclasses import replace

import pytest
import yaml
from driver_rig import Clock, Line, Rig, SimulatedPort, Wire, installed_robot, settings
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.commands.calibrate import Calibration, calibrate, main
from worm_driver.driver_errors import (
    ConfigurationError,
    CorruptReplyError,
    DriverError,
    ReleaseError,
)
from worm_driver.servos.calibration import Reading, parameter_text, spool_from
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.transmission import Fin, Spool
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.wire.packet import Instruction


@given(st.sampled_from([1, -1]), st.floats(0.008, 0.05), st.floats(0.2, 0.4))
def test_exact_readings_give_the_spool_back(sign, radius, length):
    ticks = [0, 700, 1400, 2100]
    readings = [Reading(t, length - sign * radius * t * 2 * math.pi / 4096) for t in ticks]
    spool, worst = spool_from(7, readings)
    assert (spool.servo, spool.sign) == (7, sign)
    assert spool.radius == pytest.approx(radius, abs=1e-5)
    assert worst == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("ticks", "lengths", "reason"),
    [
        ((0, 700, 1400, 2100), (0.300, 0.273, 0.236, 0.219), "off the straight line"),
        ((0, 700, 1400), (0.3, 0.3, 0.3), "is the cable attached"),
        ((0, 0), (0.3, 0.2), r"cable servo 1: .*two"),
    ],
)
def test_readings_that_show_no_spool_are_noticed(ticks, lengths, reason):
    with pytest.raises(ConfigurationError, match=reason):
        spool_from(1, list(map(Reading, ticks, lengths)))


def test_the_file_is_one_that_ros_reads():
    text = parameter_text("/dev/worm_bus", 1_000_000, [Spool(1, -1, 0.012)], [Fin(11, 1.0, 2.0)])
    parameters = yaml.safe_load(text)["/**/driver"]["ros__parameters"]
    assert parameters["cable_servos"] == {"ids": [1], "signs": [-1], "spool_radius_m": [0.012]}
    assert parameters["fin_servos"] == {
        "ids": [11],
        "forward_angle_rad": [1.0],
        "reverse_angle_rad": [2.0],
    }


class Bench(Line):
    """The virtual robot, and an operator with a ruler who answers with its true length."""

    def __init__(self, spool_radius: float = 0.025) -> None:
        (cable,) = installed_robot().cable_servos
        cables = (replace(cable, spool_radius=spool_radius),)
        super().__init__(VirtualRobot(replace(installed_robot(), cable_servos=cables)))
        self.bus.retries = 0
        self.radius = spool_radius
        self.start = self.robot.servos[0].shaft.position
        self.decision = "r"
        self.interrupted_at: str | None = None
        self.released_at: list[float] = []
        self.unarmed: list[int] = []
        self.output: list[str] = []
        self.questions: list[str] = []
        self.calibration = Calibration(self.bus, self.answer, self.output.append, self.wait)

    def _answer(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        """Note the wound length (m) at each loss of the cable's torque, and the servos without a watchdog."""
        torque, wound = self.torque, self.wound
        answers = super()._answer(data, now)
        if torque and not self.torque:
            self.released_at.append(wound)
        for servo in self.robot.servos:
            if servo.memory["torque_enable"] and servo.memory["bus_watchdog"] <= 0:
                self.unarmed.append(servo.servo_id)
        return answers

    def wait(self, duration: float) -> None:
        self.clock.now += duration

    def answer(self, question: str, meanwhile) -> str:
        """Answer as an operator who takes 5 s, longer than any watchdog."""
        for _ in range(25):
            self.clock.now += 0.2
            meanwhile()
        self.robot.advance(self.clock.now)
        self.questions.append(question)
        if self.interrupted_at is not None and self.interrupted_at in question:
            raise KeyboardInterrupt
        if "LED is lit" in question:
            return "c" if "servo 1 " in question else "f"
        if "ighter" in question:
            return "t"
        if "epeat" in question:
            return self.decision
        if "ruler" in question:
            self.robot.advance(self.clock.now)
            return f"{295.3 - self.wound * 1e3:.1f}".replace(".", ",")
        return ""

    @property
    def wound(self) -> float:
        """Length of cable on the spool, m."""
        self.robot.advance(self.clock.now)
        turned = (self.robot.servos[0].shaft.position - self.start) * 2 * math.pi / 4096
        return turned * self.radius

    @property
    def torque(self) -> int:
        return self.robot.servos[0].memory["torque_enable"]


def test_a_conversation_finds_the_virtual_robots_parameters():
    bench = Bench()
    spools, fins = calibrate(bench.calibration, turns=0.3)
    assert spools[0].servo == 1
    assert spools[0].sign == 1
    assert spools[0].radius == pytest.approx(0.025, rel=0.02)
    assert [fin.servo for fin in fins] == [11, 12]
    assert fins[0].forward_angle == pytest.approx(2.3562, abs=0.01)
    assert [servo.memory["torque_enable"] for servo in bench.robot.servos] == [0, 0, 0]
    assert [servo.memory["led"] for servo in bench.robot.servos] == [0, 0, 0]


def test_several_turns_of_a_small_spool_are_measured():
    """The way back over several turns takes a minute."""
    spools, _ = calibrate(Bench(spool_radius=0.002).calibration, turns=5.0)
    assert spools[0].radius == pytest.approx(0.002, rel=0.02)


def test_a_cancelled_conversation_returns_the_cable_before_it_releases_it():
    bench = Bench()
    bench.interrupted_at = "reading 3"
    with pytest.raises(KeyboardInterrupt):
        calibrate(bench.calibration, turns=0.3)
    assert bench.released_at == [pytest.approx(0.0, abs=1e-3)]  # a loaded servo yields by less


def test_a_second_interrupt_releases_a_contracted_robot_at_once():
    bench = Bench()
    bench.interrupted_at = "reading 3"

    def interrupt(_: float) -> None:
        if any("Ctrl-C" in line for line in bench.output):
            raise KeyboardInterrupt
        bench.wait(0.05)

    bench.calibration._wait = interrupt
    with pytest.raises(KeyboardInterrupt):
        calibrate(bench.calibration, turns=0.3)
    assert bench.released_at[0] > 0.02
    assert not bench.torque


@pytest.mark.parametrize("fault", ["stalled", "no_answer"])
def test_a_contracted_robot_that_cannot_return_keeps_its_torque(fault):
    bench = Bench()
    bench.decision = "g"
    ask = bench.answer

    def answer(question: str, meanwhile) -> str:
        if "reading 3" in question:
            bench.inject(fault, target=1, duration=1e3)
        return ask(question, meanwhile)

    bench.calibration._ask_operator = answer
    with pytest.raises(ReleaseError, match="servo 1"):
        calibrate(bench.calibration, turns=0.3)
    assert bench.torque
    assert bench.wound > 0.02


@pytest.mark.parametrize(("decision", "torque"), [("r", 0), ("g", 1)])
def test_the_operator_decides_on_a_torque_that_another_program_left_on(decision, torque):
    bench = Bench()
    servo = bench.calibration.find_servos()[0]
    bench.bus.write(1, servo["torque_enable"], 1)
    bench.calibration._ask_operator = lambda question, _: decision if "[g]" in question else "c"
    if decision == "r":
        assert bench.calibration.role(servo) == "c"
    else:
        with pytest.raises(ReleaseError):
            bench.calibration.role(servo)
    assert bench.torque == torque


@pytest.mark.parametrize("garbled", [0, 2])
def test_a_conversation_that_is_killed_with_the_torque_on_leaves_it_to_the_watchdog(
    garbled, monkeypatch
):
    """Whichever packet is the last one, no servo has its torque on without a watchdog."""
    bench = Bench()
    lose_answers(bench, monkeypatch, garbled)
    calibrate(bench.calibration, turns=0.3)
    assert bench.unarmed == []


class Killed(Exception):
    """Stands for kill -9, after which nothing is cleaned up."""


def test_a_conversation_that_is_killed_leaves_no_mark_of_a_home():
    """The LED that shows a servo to the operator is also the one that marks a home."""
    rig = Rig(settings(home_at_start=False))
    assert not rig.robot.actuators.homed
    servo = rig.robot.actuators.cables[0]
    lit: list[int] = []

    def killed(*_: object) -> str:
        lit.append(rig.cable.memory["led"])
        rig.bus.write = lambda *_: None
        raise Killed

    with pytest.raises(Killed):
        Calibration(rig.bus, killed, lambda _: None, lambda _: None).role(servo)
    assert lit == [1]
    assert rig.cable.memory["led"] == 1
    assert not rig.restarted_driver().robot.actuators.homed


def test_a_blocked_cable_ends_the_conversation():
    bench = Bench()
    bench.inject("stalled", target=1, duration=1e3)
    servo = bench.calibration.find_servos()[0]
    with pytest.raises(DriverError, match="blocked"):
        bench.calibration.cable(servo, 0.3)


def lose_answers(bench: Bench, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Garble this many responses to a goal, from the third reading on."""
    write, goals = bench.bus.write, []

    def garbled(servo, register, raw):
        if register.name == "goal_position":
            goals.append(raw)
            if 4 <= len(goals) < 4 + count:
                raise CorruptReplyError("servo 1: the answer's checksum is wrong")
        write(servo, register, raw)

    monkeypatch.setattr(bench.bus, "write", garbled)


def test_a_garbled_answer_costs_one_reading_and_not_the_session(monkeypatch):
    bench = Bench()
    lose_answers(bench, monkeypatch, 2)
    spools, _ = calibrate(bench.calibration, turns=0.3)
    assert spools[0].radius == pytest.approx(0.025, rel=0.02)
    readings = [question for question in bench.questions if "ruler" in question]
    assert [q.split(":")[0] for q in readings] == [f"reading {n} of 4" for n in (1, 2, 3, 4)]
    assert sum("readings so far are preserved" in line for line in bench.output) == 2


def test_a_person_may_give_up_after_a_garbled_answer(monkeypatch):
    bench = Bench()
    bench.decision = "g"
    lose_answers(bench, monkeypatch, 1)
    with pytest.raises(CorruptReplyError):
        calibrate(bench.calibration, turns=0.3)
    assert bench.released_at == [pytest.approx(0.0, abs=5e-4)]


def test_a_servo_that_lost_its_torque_meanwhile_is_not_read_on(monkeypatch):
    bench = Bench()
    lose_answers(bench, monkeypatch, 1)
    show = bench.output.append

    def restart(line: str) -> None:
        show(line)
        if "preserved" in line:
            bench.robot.servos[0].memory["torque_enable"] = 0

    monkeypatch.setattr(bench.calibration, "_say", restart)
    with pytest.raises(DriverError, match="run calibrate again"):
        calibrate(bench.calibration, turns=0.3)


def test_an_invalid_answer_repeats_the_question():
    bench = Bench()
    answers = iter(["x", "", "n"])
    bench.calibration._ask_operator = lambda *_: next(answers)
    assert bench.calibration.role(bench.calibration.find_servos()[0]) == "n"
    assert bench.output == ["answer with one of c, f, n"] * 2


@pytest.mark.parametrize("answer", ["nan", "1e999", "0", "-295", "", "x"])
def test_a_reading_that_is_no_length_repeats_the_question(answer):
    bench = Bench()
    ask, wrong = bench.answer, iter([answer])

    def misread(question: str, meanwhile) -> str:
        right = ask(question, meanwhile)
        return next(wrong, right) if "reading 2" in question else right

    bench.calibration._ask_operator = misread
    spools, _ = calibrate(bench.calibration, turns=0.3)
    assert spools[0].radius == pytest.approx(0.025, rel=0.02)
    assert sum("reading 2" in question for question in bench.questions) == 2
    assert sum(repr(answer) in line for line in bench.output) == 1


@pytest.mark.parametrize("late", [0.005, 0.02, 0.05])
def test_no_request_is_sent_while_a_late_answer_may_still_arrive(late):
    """Otherwise the late answer could pass for the answer to a later request."""
    bench = Bench()
    bench.bus.retries = 3
    write, in_transit = bench.port.writePort, []

    def watched(packet) -> int:
        if packet[7] == Instruction.READ:
            if not in_transit:
                bench.inject("late", target=1, value=late, count=1)
            in_transit.append(len(bench.port.ser._coming))
        return write(packet)

    bench.port.writePort = watched
    assert [servo.number for servo in bench.calibration.find_servos()] == [1, 11, 12]
    assert bench.bus.counters.timeouts > 0
    assert set(in_transit) == {0}


def test_without_servos_it_names_the_checks():
    clock = Clock()
    bus = ServoBus(SimulatedPort(Wire(clock, lambda *_: []), clock), retries=0)
    silent = Calibration(bus, lambda *_: "", lambda _: None, lambda _: None)
    with pytest.raises(ConfigurationError, match="no servo answers"):
        calibrate(silent, 0.5)


def test_a_missing_port_is_reported_in_one_line(tmp_path, capsys):
    assert main([str(tmp_path / "new.yaml"), "--port", str(tmp_path / "ttyNO")]) == 1
    assert "does not exist" in capsys.readouterr().err
    assert not (tmp_path / "new.yaml").exists()
