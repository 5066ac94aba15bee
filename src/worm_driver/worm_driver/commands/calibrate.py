# SPDX-License-Identifier: Apache-2.0
"""The command ``calibrate``: finds the servos, and asks a person with a ruler for what they cannot tell.

Ids and models come from the bus, signs and spool radii from ruler readings at a few positions, fin angles from fins
turned by hand. The servos move only after a question was answered, slowly, and are let go on every way out. One that
has its torque has its bus watchdog armed, which is fed while a question waits for its answer.
"""

import argparse
import contextlib
import functools
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType

from worm_driver.commands.driver_command import Parser, new_file
from worm_driver.control.supervision import Limits, own_limit
from worm_driver.errors import (
    BusError,
    ConfigurationError,
    CorruptReplyError,
    DriverError,
    NoReplyError,
)
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.calibration import Reading, parameter_text, spool_from
from worm_driver.servos.encoding import from_raw
from worm_driver.servos.goal_gate import Bound, GoalGate
from worm_driver.servos.position_track import PositionTrack
from worm_driver.servos.registers import MODELS, POSITION_MODE, TICKS_PER_TURN, WATCHDOG_EXPIRED
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.transmission import Fin, Spool

#: rad/s, of the spool while the cable is calibrated
_SPEED = 0.5
#: ticks, of the first small motion, which shows the direction
_PROBE = 256
#: ticks, that a position may be off its goal
_ARRIVED = 20
#: s, in which a motion must arrive
_PATIENCE = 20.0
#: s without packets after which a servo stops by itself, should this command be killed
_WATCHDOG = 1.0
#: s, from one packet to the next while a question waits for its answer
_FEEDING = 0.2
#: of an exchange that fails, before a person is asked
_RETRIES = 3

Ask = Callable[[str, Callable[[], object]], str]
Say = Callable[[str], None]


class Calibration:
    """One conversation.

    Args:
        bus: an open bus.
        ask: puts a question and returns the answer; calls what it is given several times a second meanwhile.
        say: tells something.
        wait: lets seconds pass.
    """

    def __init__(self, bus: ServoBus, ask: Ask, say: Say, wait: Callable[[float], None]):
        self._bus = bus
        self._ask_person = ask
        self._meanwhile: Callable[[], object] = lambda: None
        self._say = say
        self._wait = wait
        self._track = PositionTrack({})
        self._goals = GoalGate(bus, self._track)

    def find_servos(self) -> list[Servo]:
        """Every servo with a control table that answers; one that has none is named and left out."""
        answering = []
        for number in range(253):
            try:
                model = self._bus.ping(number).model_number
            except BusError:
                continue
            if model in MODELS:
                answering.append(servos.identify(self._bus, number))
            else:
                self._say(f"servo {number}: model number {model} is unknown here, left out")
        return answering

    def role(self, servo: Servo) -> str:
        """What a person says that a servo is for: c, f or n. Its LED is lit meanwhile.

        A lit LED marks a cable servo's home. Position mode is set first: whatever ends this conversation, a
        driver that finds it takes the turns for folded, and puts the mark out.
        """
        with self._bus.patient():
            servos.prepare(self._bus, servo, POSITION_MODE)
        self._bus.write(servo.number, servo["led"], 1)
        try:
            question = f"servo {servo.number} ({servo.model.name}), its LED is lit"
            return self._choice(f"{question}: [c]able, [f]in or [n]othing? ", "cfn")
        finally:
            self._bus.write(servo.number, servo["led"], 0)

    def cable(self, servo: Servo, turns: float, points: int) -> Spool:
        """A cable servo's spool, from ruler readings while it winds the cable up. Raises DriverError."""
        self._say(
            f"cable servo {servo.number}: turn the spool by hand until the cable is just taut"
        )
        self._ask("Enter when it is, hands off the robot ")
        with self._bus.patient():
            servos.prepare_cable(self._bus, servo, own_limit(servo, Limits()))
            start = servos.registers(self._bus, servo, "present_position")["present_position"]
        span = round(turns * TICKS_PER_TURN) + _PROBE
        self._goals.bounds = {servo.number: Bound(start - span, start + span)}
        self._torque_on(servo)
        self._reach(servo, start + _PROBE)
        shorter = self._choice(
            "the spool has turned a little: is the cable [t]auter or [s]lack? ", "ts"
        )
        direction = 1 if shorter == "t" else -1
        step = round(turns * TICKS_PER_TURN / (points - 1))
        readings = []
        for index in range(points):
            ticks = start + direction * step * index
            self._reach(servo, ticks)
            question = f"reading {index + 1} of {points}: body length on the ruler, mm: "
            readings.append(Reading(ticks - start, self._number(question) * 1e-3))
        self._reach(servo, start)
        self._torque_off(servo)
        spool, worst = spool_from(servo.number, readings)
        self._say(
            f"cable servo {servo.number}: sign {spool.sign}, spool radius {spool.radius * 1e3:.2f} mm, "
            f"readings within {worst * 1e3:.1f} mm"
        )
        return spool

    def fin(self, servo: Servo) -> Fin:
        """A fin servo's two angles, read where a person has turned it. Raises DriverError."""
        with self._bus.patient():
            servos.prepare_fin(self._bus, servo)
        register = servo["present_position"]
        angles = []
        for way in ("forward", "reverse"):
            self._ask(f"fin servo {servo.number}: turn the fins by hand to {way}, then Enter ")
            angles.append(from_raw(register, self._bus.read(servo.number, register)))
            self._say(f"  {way}: {angles[-1]:.4f} rad")
        return Fin(servo.number, *angles)

    def _ask(self, question: str) -> str:
        return self._ask_person(question, self._meanwhile)

    def _torque_on(self, servo: Servo) -> None:
        """Holds the servo where it is, with its bus watchdog armed before and fed from now on."""
        with self._bus.patient():
            servos.limit_motion(self._bus, servo, _SPEED, _WATCHDOG)
            position = servos.standing_position(self._bus, servo)
            self._track.accepts(servo.number, position, self._bus.now())
            self._goals.write(servo.number, position)
            servos.switch_on(self._bus, servo)
        self._meanwhile = functools.partial(self._feed, servo)

    def _feed(self, servo: Servo) -> None:
        """Keeps the bus watchdog from firing; a lost answer does not matter, a servo that is not fed stops."""
        with contextlib.suppress(NoReplyError, CorruptReplyError):
            self._bus.read(servo.number, servo["torque_enable"])

    def _reach(self, servo: Servo, ticks: int) -> None:
        """`_move`, repeated at a person's word when an answer is lost: the readings so far stay. Raises DriverError."""
        interrupted = False
        while True:
            try:
                if interrupted:
                    self._take_over(servo)
                self._move(servo, ticks)
                return
            except (NoReplyError, CorruptReplyError) as error:
                interrupted = True
                self._say(f"{error}; the readings so far are kept")
                if self._choice("[r]epeat this step or [g]ive up? ", "rg") == "g":
                    raise

    def _take_over(self, servo: Servo) -> None:
        """Goes on with a servo whose bus watchdog may have fired. Raises DriverError if it has lost its torque."""
        with self._bus.patient():
            torque = self._bus.read(servo.number, servo["torque_enable"])
            watchdog = self._bus.read(servo.number, servo["bus_watchdog"])
        if not torque:
            raise DriverError(
                f"servo {servo.number} has lost its torque, by a restart or an overload, and may have turned: "
                "its readings do not belong together any more; begin anew"
            )
        if watchdog == WATCHDOG_EXPIRED:
            self._torque_on(servo)

    def _torque_off(self, servo: Servo) -> None:
        self._meanwhile = lambda: None
        servos.disable(self._bus, servo)

    def _move(self, servo: Servo, ticks: int) -> None:
        """Goes there, and waits until it is there. Raises DriverError when it does not arrive."""
        self._goals.write(servo.number, ticks)
        for _ in range(round(_PATIENCE / 0.05)):
            position = self._bus.read(servo.number, servo["present_position"])
            if abs(position - ticks) <= _ARRIVED:
                return
            self._wait(0.05)
        raise DriverError(
            f"servo {servo.number} stands at {position} and does not reach {ticks}: the cable is blocked"
        )

    def _choice(self, question: str, letters: str) -> str:
        while (answer := self._ask(question).strip().lower()[:1]) not in tuple(letters):
            self._say(f"one of {', '.join(letters)}, please")
        return answer

    def _number(self, question: str) -> float:
        while True:
            answer = self._ask(question)
            try:
                return float(answer.replace(",", "."))
            except ValueError:
                self._say(f"{answer!r} is no number")


def calibrate(calibration: Calibration, turns: float, points: int) -> tuple[list[Spool], list[Fin]]:
    """The whole conversation. Raises DriverError."""
    answering = calibration.find_servos()
    if not answering:
        raise ConfigurationError("no servo answers: check the power, the cable and --baud-rate")
    roles = {servo.number: calibration.role(servo) for servo in answering}
    cables = [servo for servo in answering if roles[servo.number] == "c"]
    if not cables:
        raise ConfigurationError("a robot needs a cable servo: none was named")
    spools = [calibration.cable(servo, turns, points) for servo in cables]
    fins = [calibration.fin(servo) for servo in answering if roles[servo.number] == "f"]
    return spools, fins


def _arguments(arguments: list[str] | None) -> argparse.Namespace:
    parser = Parser(
        prog="calibrate",
        description="Finds the servos, and asks a person with a ruler for what they cannot tell.",
    )
    parser.add_argument("output", type=new_file, help="parameter file to write; must not exist")
    parser.add_argument("--port", default="/dev/worm_bus", help="default: %(default)s")
    parser.add_argument("--baud-rate", type=int, default=1_000_000, help="default: %(default)s")
    parser.add_argument(
        "--turns",
        type=float,
        default=0.5,
        help="of the spool, that are measured; default: %(default)s",
    )
    parser.add_argument(
        "--points", type=int, default=4, help="ruler readings; default: %(default)s"
    )
    options = parser.parse_args(arguments)
    if options.points < 3:
        parser.error("--points must be 3 at least")
    if not 0.05 <= options.turns <= 5.0:
        parser.error("--turns must be 0.05 to 5")
    return options


@contextlib.contextmanager
def _torque_released_at_the_end(port: str, baud_rate: int) -> Iterator[ServoBus]:
    bus = ServoBus.open(port, baud_rate, retries=_RETRIES)
    try:
        yield bus
    finally:
        with contextlib.suppress(BusError):
            bus.torque_off_all()
        bus.close()


def _interrupt(_: int, __: FrameType | None) -> None:
    raise KeyboardInterrupt


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    options = _arguments(arguments)
    signal.signal(signal.SIGTERM, _interrupt)
    signal.signal(signal.SIGHUP, _interrupt)
    try:
        with _torque_released_at_the_end(options.port, options.baud_rate) as bus:
            calibration = Calibration(bus, _ask, _say, time.sleep)
            spools, fins = calibrate(calibration, options.turns, options.points)
        text = parameter_text(options.port, options.baud_rate, spools, fins)
        with options.output.open("x", encoding="utf-8") as file:
            file.write(text)
    except ConfigurationError as error:
        return _fail(error, 2)
    except (DriverError, OSError) as error:
        return _fail(error, 1)
    except (KeyboardInterrupt, EOFError):
        return _fail("given up; the servos are let go, nothing was written", 1)
    _say(f"written: {options.output}")
    return 0


def _ask(question: str, meanwhile: Callable[[], object]) -> str:
    """A line of standard input. Raises EOFError at its end."""
    print(question, end="", flush=True)  # noqa: T201 (a conversation)
    while not select.select([sys.stdin], [], [], _FEEDING)[0]:
        meanwhile()
    line = sys.stdin.readline()
    if not line:
        raise EOFError
    return line.rstrip("\n")


def _say(text: str) -> None:
    print(text)  # noqa: T201 (a conversation)


def _fail(error: object, status: int) -> int:
    print(f"calibrate: {error}", file=sys.stderr)  # noqa: T201
    return status
