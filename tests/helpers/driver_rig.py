# SPDX-License-Identifier: Apache-2.0
"""The driver's robot on the virtual robot, byte for byte, on a clock that only the rig advances.

Nothing here waits: a timeout of the driver is a jump of the clock. An operation of the driver that takes 70 ms takes
exactly that in every run, however busy the machine is.
"""

import copyreg
import errno
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import MappingProxyType

import serial

from worm_driver.clock import MachineClock
from worm_driver.control.control_loop import ControlLoop
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.robot import CycleSnapshot, Robot
from worm_driver.gait.gait_player import Phase, PlayerSettings
from worm_driver.power import socket_smbus as frames
from worm_driver.power.i2c import I2CDevice
from worm_driver.power.ina219 import INA219, PowerSample, SampleStatus, calibration_for
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import BusPort, ServoBus
from worm_driver.servos.transmission import Spool
from worm_driver.virtual_robot.servo.control_table import VirtualServoModel
from worm_driver.virtual_robot.servo.virtual_servo import Servo
from worm_driver.virtual_robot.virtual_bus import Transmission
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings, load_settings
from worm_driver.virtual_robot.wire.faults import make_fault
from worm_driver.virtual_robot.wire.packet import (
    Instruction,
    InstructionReader,
    Packet,
    frame,
    stuff,
)
from worm_msgs.gait import Gait

# `Rig.copy`: the copy gets its own threads and events, as the rig starts none. It shares the read-only tables.
copyreg.pickle(threading.Thread, lambda _: (threading.Thread, ()))
copyreg.pickle(threading.Event, lambda _: (threading.Event, ()))
copyreg.pickle(type(threading.Lock()), lambda _: (threading.Lock, ()))
copyreg.pickle(MappingProxyType, lambda _: "the table itself")

#: instructions that change nothing
READING = {Instruction.PING, Instruction.READ, Instruction.SYNC_READ}
BAUD_RATE = 1_000_000
BYTE_TIME = 10 / BAUD_RATE
CABLE = 1


class Clock(MachineClock):
    """Clock that stands still until a test sets it, s."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep_until(self, due: float) -> None:
        self.now = max(self.now, due)

    def close(self) -> None:
        return None


class Wire:
    """Replacement of serial.Serial: a function gets the bytes at once, and its responses arrive at their time."""

    def __init__(self, clock: Clock, answer: Callable[[bytes, float], list[tuple[float, bytes]]]):
        self.clock = clock
        self.sent: list[bytes] = []
        self.unplugged = False
        self._answer = answer
        self._coming: list[tuple[float, bytes]] = []
        self._buffer = b""

    def write(self, data: bytes) -> int:
        self._check()
        self.sent.append(bytes(data))
        self.clock.now += len(data) * BYTE_TIME
        line_free = self.clock.now
        for due, answer in self._answer(bytes(data), self.clock.now):
            arrival = max(due, line_free) + len(answer) * BYTE_TIME
            line_free = arrival if due <= line_free else line_free
            self.inject(arrival, answer)
        return len(data)

    def inject(self, arrival: float, data: bytes) -> None:
        """Let bytes arrive at a time (s)."""
        self._coming.append((arrival, data))
        self._coming.sort(key=lambda item: item[0])

    def read(self, length: int) -> bytes:
        self._check()
        self._take()
        data, self._buffer = self._buffer[:length], self._buffer[length:]
        return data

    def reset_input_buffer(self) -> None:
        self._check()
        self._take()
        self._buffer = b""

    def wait(self, timeout: float) -> bool:
        self._take()
        if not self._buffer and timeout > 0.0:
            end = self.clock.now + max(timeout, 1e-9)
            self.clock.now = min(end, self._coming[0][0]) if self._coming else end
            self._take()
        return bool(self._buffer)

    def close(self) -> None:
        return None

    def _take(self) -> None:
        while self._coming and self._coming[0][0] <= self.clock.now:
            self._buffer += self._coming.pop(0)[1]

    def _check(self) -> None:
        if self.unplugged:
            raise serial.SerialException(errno.EIO, "device disconnected")


class SimulatedPort(BusPort):
    """The driver's port on a Wire."""

    def __init__(self, wire: Wire, clock: Clock):
        super().__init__("/dev/simulated", BAUD_RATE)
        self.go_by(clock)
        self.ser = wire
        self.is_open = True
        self.tx_time_per_byte = BYTE_TIME * 1e3

    def _wait(self, timeout: float) -> bool:
        self.ser._check()
        return self.ser.wait(timeout)

    def writePort(self, packet) -> int:
        return self.ser.write(packet)

    def setupPort(self, cflag_baud: int) -> bool:
        return True

    def closePort(self) -> None:
        self.is_open = False


class Bench:
    """Servo bus on virtual servos that hear only their own baud rate, with a record of the instructions.

    Args:
        receive: returns the answers to bytes at a time (s) and baud rate (bit/s), as `VirtualRobot.receive`.
    """

    def __init__(self, receive: Callable[[bytes, float, int], list[Transmission]]):
        self._receive = receive
        self.clock = Clock()
        self.wire = Wire(self.clock, self._answer)
        self.port = SimulatedPort(self.wire, self.clock)
        self.bus = ServoBus(self.port)

    def _answer(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        return [(t.time, t.data) for t in self._receive(data, now, self.port.baudrate)]

    @property
    def written(self) -> list[Packet]:
        """Instructions that change something."""
        sent = InstructionReader(1.0).feed(b"".join(self.wire.sent), self.clock.now)
        return [packet for packet in sent if packet.instruction not in READING]


class Line(Bench):
    """Bus with the servos of a virtual robot, by default the installed one, on a clock of its own."""

    def __init__(self, robot: VirtualRobot | None = None) -> None:
        self.robot = robot or VirtualRobot(installed_robot())
        super().__init__(self.robot.receive)

    def inject(self, name: str, **arguments: object) -> None:
        """Inject a fault of the virtual robot now."""
        self.robot.board.add(make_fault(name, **arguments).delayed(self.clock.now))


class DirectSMBus:
    """The two smbus2 calls that the driver uses, on the virtual robot's power sensor."""

    def __init__(self, robot: VirtualRobot, clock: Clock):
        self._robot = robot
        self._clock = clock

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        answer = self._transact(frames.Request(frames.READ, i2c_addr, register))
        return int.from_bytes(answer.data, "little")

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        data = value.to_bytes(2, "little")
        self._transact(frames.Request(frames.WRITE, i2c_addr, register, data=data))

    def close(self) -> None:
        return None

    def _transact(self, request: frames.Request) -> frames.Answer:
        answer = self._robot.transact(request, self._clock.now)
        if answer.errno:
            raise OSError(answer.errno, "virtual robot")
        return answer


class QuickSettings(DriverSettings):
    """Settings with short rests, so that whole gaits take little time."""

    @cached_property
    def player(self) -> PlayerSettings:
        return replace(
            super().player,
            rest_duration=0.05,
            settle_time=0.02,
            rest_samples=2,
            rest_timeout=0.2,
            flip_timeout=1.5,
        )


def settings(kind: type[DriverSettings] = DriverSettings, **changes: object) -> DriverSettings:
    """Return the settings of a driver for the virtual robot of the installed file."""
    given = kind(
        port="/dev/simulated",
        real_time_priority=0,
        home_at_start=True,
        **spool_parameters([Spool(CABLE, 1, 0.025)]),
        fin_ids=(11, 12),
        forward_angles=(2.3562, 2.3562),
        reverse_angles=(3.9270, 3.9270),
    )
    return replace(given, **changes)


def spool_parameters(spools: Sequence[Spool]) -> dict[str, tuple[float, ...]]:
    """Return the parameters of the driver with these spools."""
    columns = zip(*((spool.servo, spool.sign, spool.radius) for spool in spools), strict=True)
    return dict(zip(("cable_ids", "cable_signs", "spool_radii"), columns, strict=True))


@dataclass(frozen=True)
class WrittenGoal:
    """Goal position on the bus: ticks as the servo counts, and the shaft's true position at that time."""

    time: float
    servo: int
    ticks: int
    shaft: int

    @property
    def distance(self) -> float:
        """Distance in m of cable from the shaft's true position to the goal."""
        return abs(self.ticks - self.shaft) * 2 * math.pi / 4096 * 0.025


def goals_in(packet) -> Iterator[tuple[int, int]]:
    """Return servo and ticks of each goal position in an instruction packet, written alone or in a sync write."""
    row = COMMON["goal_position"]
    data = packet.parameters
    if int.from_bytes(data[:2], "little") != row.address:
        return
    if packet.instruction == Instruction.WRITE:
        yield packet.servo_id, int.from_bytes(data[2:6], "little", signed=True)
    elif packet.instruction == Instruction.SYNC_WRITE:
        for at in range(4, len(data), 1 + row.size):
            yield data[at], int.from_bytes(data[at + 1 : at + 5], "little", signed=True)


@cache
def installed_robot() -> RobotSettings:
    """Return the settings of the installed virtual robot, read once."""
    return load_settings()


class Rig:
    """A driver's robot, a virtual robot, and the clock of both."""

    def __init__(
        self,
        driver: DriverSettings | None = None,
        virtual: VirtualRobot | None = None,
        clock: Clock | None = None,
        why_not_start: Callable[[], str] = lambda: "",
    ):
        self.clock = clock or Clock()
        self.virtual = virtual or VirtualRobot(installed_robot())
        self.wire = Wire(self.clock, self._answer)
        self.bus = ServoBus(SimulatedPort(self.wire, self.clock))
        self.goals: list[WrittenGoal] = []
        self._reader = InstructionReader(1.0)
        self.speeds: list[tuple[float, float]] = []
        self.positions: list[tuple[float, float]] = []
        self.samples: list[PowerSample] = []
        self._valid = 0
        self.snapshots: list[CycleSnapshot] = []
        self.settings = driver or settings()
        self.sensor = INA219(
            I2CDevice(DirectSMBus(self.virtual, self.clock), "simulated", 0x40),
            0.1,
            calibration_for(0.1, 3.2),
        )
        self.sensor.start()
        self.robot = Robot(
            self.settings,
            self.bus,
            self._valid_samples,
            clock=self.clock,
            why_not_start=why_not_start,
        )
        self.loop = ControlLoop(self.robot, self._publish, self.clock)
        self.ended = False

    def advance(self, time: float) -> None:
        """Let the virtual robot move, and record how fast its cable servo turns."""
        step = self.virtual.settings.step
        while self.virtual.time + step <= time + 1e-9:
            self.virtual.advance(self.virtual.time + step)
            self.speeds.append((self.virtual.time, self.cable_speed))
            self.positions.append((self.virtual.time, self.cable.shaft.position))

    def _answer(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        self.advance(now)
        servos = {servo.servo_id: servo for servo in self.virtual.servos}
        for packet in self._reader.feed(data, now):
            for number, ticks in goals_in(packet):
                shaft = servos[number]._encoder.raw(servos[number].shaft.position)
                self.goals.append(WrittenGoal(now, number, ticks, shaft))
        return [(t.time, t.data) for t in self.virtual.receive(data, now, BAUD_RATE)]

    def _publish(self, snapshot: CycleSnapshot) -> None:
        self.snapshots.append(snapshot)

    def _valid_samples(self) -> int:
        return self._valid

    def copy(self) -> "Rig":
        """Return a rig in the same state. Neither rig notices what happens to the other one."""
        past = (
            self.wire.sent,
            self.goals,
            self.speeds,
            self.positions,
            self.samples,
            self.snapshots,
        )
        unchanging = [self.settings, self.virtual.settings, self.virtual.plant]
        unchanging += [item for record in past for item in record]
        return deepcopy(self, {id(item): item for item in unchanging})

    def restarted_driver(self, driver: DriverSettings | None = None) -> "Rig":
        """Return a new driver on the same virtual robot."""
        return Rig(driver or self.settings, self.virtual, self.clock)

    @property
    def home_ticks(self) -> float:
        """Shaft position (ticks) of the virtual cable servo at the driver's 0."""
        return self.virtual.settings.cable_servos[0].start_angle * 4096 / (2 * math.pi)

    @property
    def cable(self):
        """The virtual cable servo."""
        return self.virtual.servos[0]

    @property
    def torques(self) -> list[int]:
        """The torque (1 on, 0 off) of each virtual servo."""
        return [servo.memory["torque_enable"] for servo in self.virtual.servos]

    @property
    def contraction(self) -> float:
        """Largest contraction (m) of a cable, by the shafts, which no fault of the bus affects."""
        return max(-length for length in shaft_lengths(self))

    @property
    def cable_speed(self) -> float:
        """Highest speed (m/s) at which a servo moves its cable, without the yield of its loaded shaft."""
        cables = self.virtual.servos[: len(self.settings.spools)]
        return max(abs(servo.motor.velocity) for servo in cables) * 2 * math.pi / 4096 * 0.025

    def run(
        self, duration: float, until: Callable[[CycleSnapshot], bool] | None = None
    ) -> CycleSnapshot:
        """Run cycles for a duration (s), or until a snapshot fulfils a condition.

        A condition that is never fulfilled fails the test.
        """
        end = self.clock.now + duration
        while self.clock.now < end:
            period = self.settings.period
            self.clock.now = (int(self.clock.now / period + 1e-6) + 1) * period
            self.advance(self.clock.now)
            sample = self.sensor.sample(self.clock.now)
            self.samples.append(sample)
            self._valid += sample.status is SampleStatus.VALID
            self.ended = not self.loop._step(self.clock.now)
            if until is not None and until(self.snapshots[-1]):
                return self.snapshots[-1]
        assert until is None, f"it did not happen within {duration} s: {self.robot.player}"
        return self.snapshots[-1]

    def end(self) -> list[str]:
        """End the driver's thread and return the messages about the release."""
        self.loop._at_end()
        return self.loop.release_problems

    def activate(self) -> None:
        """Switch the torque on."""
        self.run(0.1)
        self.robot.activate(self.clock.now)

    def start(
        self,
        stroke: float = 0.07,
        frequency: float = 0.4,
        cycles: int = 5,
        direction: int = 1,
        **waveform: float,
    ):
        """Start a run."""
        gait = Gait(stroke, frequency, direction, **waveform)
        return self.robot.start(self.clock.now, gait, cycles)

    def play(self, *gait: float, **waveform: float) -> "Rig":
        """Start a run as `start` does, with the torque on, and return the rig when its gait begins."""
        if not self.robot.active:
            self.activate()
        self.start(*gait, **waveform)
        self.run(12.0, until=lambda s: s.player.phase is Phase.RUNNING)
        return self

    def deactivate(self, longest: float = 10.0) -> None:
        """Bring the cable to rest and switch the torque off."""
        self.robot.ramp_to_rest(self.clock.now, "deactivated")
        self.run(longest, until=lambda _: self.robot.released)
        assert self.robot.release() == []

    def inject(self, name: str, **arguments: object) -> None:
        """Inject a fault of the virtual robot now."""
        self.advance(self.clock.now)
        self.virtual.board.add(make_fault(name, **arguments).delayed(self.clock.now))

    def time_to_stop(self, longest: float = 1.0) -> float:
        """Return the time in s from now until the servo last moves the cable, within the observed duration."""
        begin = self.clock.now
        self.speeds.clear()
        self.run(longest)
        return max((time for time, speed in self.speeds if speed > 0.002), default=begin) - begin


#: two spools of opposite signs
SPOOLS = (Spool(1, 1, 0.025), Spool(2, -1, 0.025))


def robot_with_spools(spools: Sequence[Spool]) -> VirtualRobot:
    """Return the installed virtual robot with these spools."""
    (cable,) = installed_robot().cable_servos
    cables = tuple(replace(cable, id=spool.servo, sign=spool.sign) for spool in spools)
    return VirtualRobot(replace(installed_robot(), cable_servos=cables))


def two_spools(**changes: object) -> Rig:
    """Return a rig with two spools."""
    return Rig(settings(**spool_parameters(SPOOLS), **changes), robot_with_spools(SPOOLS))


def rig_of_model(model: VirtualServoModel, **changes: object) -> Rig:
    """Return a rig with one cable servo and fin servo 11 of a model at its voltage, and short rests."""
    usual = installed_robot()
    virtual = replace(
        usual,
        cable_servos=(replace(usual.cable_servos[0], model=model, spool_radius=0.01),),
        fin_servos=(replace(usual.fin_servos[0], model=model),),
        supply=replace(usual.supply, voltage=model.nominal_voltage),
    )
    one_fin = {"fin_ids": (11,), "forward_angles": (2.3562,), "reverse_angles": (3.9270,)}
    given = settings(QuickSettings, spool_radii=(0.01,), **one_fin, **changes)
    return Rig(given, VirtualRobot(virtual))


def slow_down(servo: Servo, speed: float) -> None:
    """Let another program limit the speed (m/s) of a cable servo, until the next activation."""
    row = servo.model.registers["profile_velocity"]
    servo.write(row.address, row.pack(max(1, round(speed / 0.025 / (0.229 * math.tau / 60)))))


def shaft_lengths(rig: Rig) -> list[float]:
    """Return the length change (m) of each cable by the shaft of its servo, which no fault of the bus affects."""
    lengths = []
    for spool in rig.settings.spools:
        servo = next(s for s in rig.virtual.servos if s.servo_id == spool.servo)
        lengths.append(spool.length_change(servo._encoder.raw(servo.shaft.position)))
    return lengths


@cache
def _idle() -> Rig:
    rig = Rig()
    rig.activate()
    rig.run(0.2)
    return rig


@cache
def _moving() -> Rig:
    rig = Rig().play()
    rig.run(0.6)
    assert rig.cable_speed > 0.05
    return rig


def instruction_packet(servo_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return the bytes of an instruction packet."""
    return frame(servo_id, stuff(bytes([instruction]) + parameters))


def idle() -> Rig:
    """Return a rig of its own with the torque on."""
    return _idle().copy()


def moving() -> Rig:
    """Return a rig of its own in a gait, at full speed."""
    return _moving().copy()
