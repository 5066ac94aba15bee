# SPDX-License-Identifier: Apache-2.0
"""Command ``calibrate``: find the servos, and measure signs, spool radii and fin angles with an operator.

Ids and models are read from the bus. Signs and spool radii follow from ruler readings at a few positions, and fin
angles from positions to which the operator turns the fins. The servos move slowly, and only after the operator has
answered a question. There is one exception: after a failure or a Ctrl-C, a cable servo first returns to the position
where its calibration began, and is released there. While the torque of a servo is on, the servo's bus watchdog is
armed. While a question waits for its answer, the command resets this watchdog.
"""

import argparse
import contextlib
import functools
import math
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType

from worm_driver.commands.driver_command import new_file, run_command, within
from worm_driver.control.actuators import own_limit
from worm_driver.driver_errors import (
    ConfigurationError,
    CorruptReplyError,
    DriverError,
    NoReplyError,
    ReleaseError,
)
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.calibration import Reading, parameter_text, spool_from
from worm_driver.servos.goal_gate import Bound, GoalGate
from worm_driver.servos.position_track import PositionTrack
from worm_driver.servos.registers import MODELS, POSITION_MODE, TICKS_PER_TURN, WATCHDOG_EXPIRED
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.transmission import Fin, Spool
from worm_msgs.command_parser import Parser
from worm_msgs.driver_file import DriverFile

#: rad/s, speed of the spool during the calibration
_SPEED = 0.5
#: ticks, size of the first small motion, which shows in which direction the spool winds the cable up
_PROBE = 256
#: ticks, distance from a goal within which the servo has arrived
_ARRIVED = 20
#: ticks, largest distance from a goal at which a load can hold a servo with the factory gain, see `control.actuators`
_YIELD = 142
#: s, period of reading the position during a motion
_MOTION_PERIOD = 0.05
#: s, time without approach to the goal after which a motion has failed. It is shorter than the overload that makes a
#: servo shut down, after which a contracted body springs back.
_STUCK = 0.5
#: s, time without packets after which a servo stops by itself, for example because this command was killed
_WATCHDOG = 1.0
#: s, period of resets of the watchdog while a question waits for its answer
_FEEDING = 0.2
#: number of repetitions of a failed exchange before the operator must decide
_RETRIES = 3
#: number of ruler readings
_READINGS = 4

Ask = Callable[[str, Callable[[], object]], str]
Say = Callable[[str], None]


class Calibration:
    """Dialogue with the operator.

    Args:
        bus: open servo bus.
        ask: prints a question and returns the answer. While it waits, it calls its second argument several times a
            second.
        say: prints a line.
        wait: waits for a time (s).
    """

    def __init__(self, bus: ServoBus, ask: Ask, say: Say, wait: Callable[[float], None]):
        self._bus = bus
        self._ask_operator = ask
        self._meanwhile: Callable[[], object] = lambda: None
        self._say = say
        self._wait = wait
        self._track = PositionTrack({})
        self._goals = GoalGate(bus, self._track)

    def find_servos(self) -> list[Servo]:
        """Return all servos that answer and have a supported model. Print the ids of servos with other models."""
        answering = []
        for number in range(253):
            try:
                model = self._bus.ping(number).model_number
            except NoReplyError:
                continue
            except CorruptReplyError as error:
                self._say(f"servo {number} is excluded: {error}")
                continue
            if model in MODELS:
                with self._bus.retrying():
                    answering.append(servos.identify(self._bus, number))
            else:
                self._say(
                    f"servo {number}: model number {model} is not supported; the servo is excluded"
                )
        return answering

    def role(self, servo: Servo) -> str:
        """Ask the operator for the role of a servo, with its LED lit. Return c (cable), f (fin) or n (none).

        A lit LED is also the home mark of a cable servo, and the LED may stay lit if the dialogue is interrupted. So
        the servo is first set to position mode, in which a driver ignores the mark.
        """
        self._require_no_torque(servo)
        with self._bus.retrying():
            servos.prepare(self._bus, servo, {"operating_mode": POSITION_MODE})
        self._bus.write(servo.number, servo["led"], 1)
        try:
            question = f"servo {servo.number} ({servo.model.name}), its LED is lit"
            return self._choice(f"{question}: [c]able, [f]in or [n]othing? ", "cfn")
        finally:
            self._bus.write(servo.number, servo["led"], 0)

    def cable(self, servo: Servo, turns: float) -> Spool:
        """Return the spool of a cable servo, from ruler readings while the servo winds the cable up.

        Args:
            servo: cable servo.
            turns: turns of the spool from the first to the last reading.
        """
        self._say(
            f"cable servo {servo.number}: turn the spool manually until the cable is just taut,"
        )
        self._ask("then do not touch the robot, and press Enter ")
        with self._bus.retrying():
            servos.prepare_cable(self._bus, servo, own_limit(servo, DriverFile()))
            start = servos.registers(self._bus, servo, "present_position")["present_position"]
        span = round(turns * TICKS_PER_TURN) + _PROBE
        self._goals.bounds = {servo.number: Bound(start - span, start + span)}
        with self._held(servo, start):
            self._reach(servo, start + _PROBE)
            tighter = self._choice(
                "the spool has turned a little. Is the cable [t]ighter or [s]lack? ", "ts"
            )
            direction = 1 if tighter == "t" else -1
            step = round(turns * TICKS_PER_TURN / (_READINGS - 1))
            readings = []
            for index in range(_READINGS):
                ticks = start + direction * step * index
                position = self._reach(servo, ticks)
                question = f"reading {index + 1} of {_READINGS}: body length on the ruler, mm: "
                readings.append(Reading(position - start, self._length(question) * 1e-3))
            self._reach(servo, start)
        spool, worst = spool_from(servo.number, readings)
        self._say(
            f"cable servo {servo.number}: sign {spool.sign}, spool radius {spool.radius * 1e3:.2f} mm, "
            f"readings within {worst * 1e3:.1f} mm"
        )
        return spool

    def fin(self, servo: Servo) -> Fin:
        """Return the fin with its two angles, read after the operator has turned the fins. Raises DriverError."""
        with self._bus.retrying():
            servos.prepare_fin(self._bus, servo)
        register = servo["present_position"]
        angles = []
        for way in ("forward", "reverse"):
            self._ask(
                f"fin servo {servo.number}: turn the fins manually to {way}, then press Enter "
            )
            angles.append(register.from_raw(self._bus.read(servo.number, register)))
            self._say(f"  {way}: {angles[-1]:.4f} rad")
        return Fin(servo.number, *angles)

    def _ask(self, question: str) -> str:
        return self._ask_operator(question, self._meanwhile)

    def _require_no_torque(self, servo: Servo) -> None:
        """Let the operator decide whether a servo that another program left with its torque on may be released."""
        with self._bus.retrying():
            torque = servos.registers(self._bus, servo, "torque_enable")["torque_enable"]
        if not torque:
            return
        self._say(
            f"servo {servo.number} has its torque on. If the body is contracted, it springs back on release."
        )
        if self._choice("[r]elease the torque now or [g]ive up? ", "rg") == "g":
            raise ReleaseError(f"servo {servo.number} keeps its torque")

    @contextlib.contextmanager
    def _held(self, servo: Servo, start: int) -> Iterator[None]:
        """Hold a cable servo within the context, and release it afterwards.

        The context must end with the servo at its start (ticks). After a failure or a Ctrl-C, the servo first returns
        there, because a contracted body springs back. Only a Ctrl-C during this return releases the servo at once.
        """
        try:
            self._torque_on(servo)
            yield
        except BaseException:
            self._return(servo, start)
            raise
        finally:
            self._meanwhile = lambda: None
        self._release(servo)

    def _return(self, servo: Servo, start: int) -> None:
        """Return a cable servo to its start (ticks) after a failure, and release it."""
        self._say(
            f"cable servo {servo.number} returns to its start and is released there; Ctrl-C releases it at once"
        )
        try:
            with self._bus.retrying():
                if self._bus.read(servo.number, servo["torque_enable"]):
                    self._resume(servo)
                    self._move(servo, start)
        except DriverError as error:
            raise ReleaseError(
                f"{error}. Servo {servo.number} keeps its torque, as a contracted body springs back on release: clear "
                "the space of the stroke, then switch the supply of the servos off"
            ) from error
        except KeyboardInterrupt:
            self._say("released at once")
        self._release(servo)

    def _release(self, servo: Servo) -> None:
        if problems := servos.release_all(self._bus, [servo]):
            raise ReleaseError(
                f"{'; '.join(problems)}: the torque may still be on; switch the supply of the servos off"
            )

    def _torque_on(self, servo: Servo) -> None:
        """Arm the bus watchdog of a servo, and hold the servo where it is. Questions then reset the watchdog."""
        with self._bus.retrying():
            servos.reset_control(self._bus, servo, _SPEED)
            servos.arm_watchdog(self._bus, servo, _WATCHDOG)
            position = servos.standing_position(self._bus, servo)
            self._track.record_if_plausible(servo.number, position, self._bus.now())
            self._goals.write(servo.number, position)
            servos.switch_on(self._bus, servo)
        self._meanwhile = functools.partial(self._reset_watchdog, servo)

    def _reset_watchdog(self, servo: Servo) -> None:
        """Reset the bus watchdog. Ignore lost answers: if the servo receives no packets, it stops."""
        with contextlib.suppress(NoReplyError, CorruptReplyError):
            self._bus.read(servo.number, servo["torque_enable"])

    def _reach(self, servo: Servo, ticks: int) -> int:
        """Move a servo, see `_move`. A lost answer lets the operator repeat the step. Raises DriverError."""
        interrupted = False
        while True:
            try:
                if interrupted:
                    self._resume(servo)
                return self._move(servo, ticks)
            except (NoReplyError, CorruptReplyError) as error:
                interrupted = True
                self._say(f"{error}; the readings so far are preserved")
                if self._choice("[r]epeat this step or [g]ive up? ", "rg") == "g":
                    raise

    def _resume(self, servo: Servo) -> None:
        """Hold a servo again if its bus watchdog has fired. Raises DriverError if the servo has lost its torque."""
        with self._bus.retrying():
            torque = self._bus.read(servo.number, servo["torque_enable"])
            watchdog = self._bus.read(servo.number, servo["bus_watchdog"])
        if not torque:
            raise DriverError(
                f"servo {servo.number} has lost its torque, by a restart or an overload, and may have turned: "
                "its readings are inconsistent; run calibrate again"
            )
        if watchdog == WATCHDOG_EXPIRED:
            self._torque_on(servo)

    def _move(self, servo: Servo, ticks: int) -> int:
        """Move a servo to a position (ticks), wait until it arrives, and return its position.

        A load holds the servo at a distance from the goal.
        """
        self._goals.write(servo.number, ticks)
        nearest, stuck = math.inf, 0.0
        while stuck < _STUCK:
            position = self._bus.read(servo.number, servo["present_position"])
            distance = abs(position - ticks)
            if distance <= _ARRIVED:
                return position
            if distance < nearest - _ARRIVED:
                nearest, stuck = distance, 0.0
            self._wait(_MOTION_PERIOD)
            stuck += _MOTION_PERIOD
        if distance <= _YIELD:
            return position
        self._goals.write(servo.number, position)
        raise DriverError(
            f"servo {servo.number} stopped at {position} ticks on the way to {ticks} ticks: the cable is blocked, or "
            "its load is too large for the servo or its supply"
        )

    def _choice(self, question: str, letters: str) -> str:
        while (answer := self._ask(question).strip().lower()[:1]) not in tuple(letters):
            self._say(f"answer with one of {', '.join(letters)}")
        return answer

    def _length(self, question: str) -> float:
        """Ask the operator for a length until the answer is a positive, finite number. Return this number."""
        while True:
            answer = self._ask(question)
            try:
                length = float(answer.replace(",", "."))
            except ValueError:
                self._say(f"{answer!r} is not a number")
                continue
            if 0.0 < length < math.inf:
                return length
            self._say(f"{answer!r} is not a length: enter a positive number")


def calibrate(calibration: Calibration, turns: float) -> tuple[list[Spool], list[Fin]]:
    """Run the dialogue, and return the spools and the fins. Raises DriverError.

    `Calibration.cable` explains ``turns``.
    """
    answering = calibration.find_servos()
    if not answering:
        raise ConfigurationError("no servo answers: check the power, the cable and --baud-rate")
    roles = {servo.number: calibration.role(servo) for servo in answering}
    cables = [servo for servo in answering if roles[servo.number] == "c"]
    if not cables:
        raise ConfigurationError("no cable servo was selected: a robot needs at least one")
    spools = [calibration.cable(servo, turns) for servo in cables]
    fins = [calibration.fin(servo) for servo in answering if roles[servo.number] == "f"]
    return spools, fins


def _parser() -> Parser:
    parser = Parser(
        prog="calibrate",
        description="Find the servos, and measure signs, spool radii and fin angles with an operator and a ruler. The "
        "servos move slowly, and only after an answer; after a failure or a Ctrl-C, a cable servo returns to its "
        "start.",
    )
    parser.add_argument(
        "output", type=new_file, help="parameter file of the driver to write; must not exist"
    )
    parser.add_argument("--port", default="/dev/worm_bus", help="serial port; default: %(default)s")
    parser.add_argument(
        "--baud-rate", type=int, default=1_000_000, help="bit/s; default: %(default)s"
    )
    parser.add_argument(
        "--turns",
        type=within(0.05, 5.0),
        default=0.5,
        help="turns of the spool from the first to the last ruler reading, 0.05 to 5; default: %(default)s",
    )
    return parser


def _interrupt(_: int, __: FrameType | None) -> None:
    raise KeyboardInterrupt


def _run(options: argparse.Namespace) -> None:
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    with contextlib.closing(
        ServoBus.open(options.port, options.baud_rate, retries=_RETRIES)
    ) as bus:
        spools, fins = calibrate(Calibration(bus, _ask, _say, time.sleep), options.turns)
    text = parameter_text(options.port, options.baud_rate, spools, fins)
    with options.output.open("x", encoding="utf-8") as file:
        file.write(text)
    _say(f"written: {options.output}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)


def _ask(question: str, meanwhile: Callable[[], object]) -> str:
    """Return a line of standard input. Call ``meanwhile`` until it arrives. The end of the input is a Ctrl-C."""
    print(question, end="", flush=True)  # noqa: T201 (a dialogue)
    while not select.select([sys.stdin], [], [], _FEEDING)[0]:
        meanwhile()
    line = sys.stdin.readline()
    if not line:
        raise KeyboardInterrupt
    return line.rstrip("\n")


def _say(text: str) -> None:
    print(text)  # noqa: T201 (a dialogue)
