# SPDX-License-Identifier: Apache-2.0
"""Command ``setup_servo``: give the only servo on the bus its id, baud rate, return delay and limits.

Each step writes the registers that differ, and reads them back. After an interruption, the next call finds the servo at
any baud rate, and does what is left.
"""

import argparse
import contextlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

from worm_driver.commands.driver_command import run_command, within
from worm_driver.driver_errors import ConfigurationError, CorruptReplyError, NoReplyError
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.registers import BAUD_RATES, HIGHEST_ID
from worm_driver.servos.servo_bus import Identity, ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_msgs.command_parser import DONE, FAILED, Parser

Say = Callable[[str], None]


@dataclass(frozen=True)
class FoundServo:
    """The only servo on the bus: its id, its answer to a ping, and its baud rate (bit/s)."""

    number: int
    identity: Identity
    baud_rate: int


def find_only_servo(bus: ServoBus, say: Say) -> FoundServo:
    """Return the only servo that answers at any baud rate, and leave the bus at its rate."""
    found = []
    for rate in BAUD_RATES:
        bus.set_baud_rate(rate)
        answering = bus.scan()
        found += [FoundServo(number, identity, rate) for number, identity in answering.items()]
        say(f"{rate:>7} bit/s: {', '.join(map(str, answering)) or 'no servo'}")
    if not found:
        raise ConfigurationError(
            "no servo answers at any baud rate: check its power and its cable, then repeat"
        )
    if len(found) > 1:
        where = ", ".join(f"{servo.number} at {servo.baud_rate} bit/s" for servo in found)
        raise ConfigurationError(
            f"several servos answer (ids {where}): leave only the one to set up on the bus, and repeat"
        )
    bus.set_baud_rate(found[0].baud_rate)
    return found[0]


def set_up(bus: ServoBus, found: FoundServo, number: int, baud_rate: int, say: Say) -> None:
    """Write and verify limits, return delay, id and baud rate of a servo, in this order.

    Args:
        bus: servo bus at the servo's baud rate.
        found: the servo.
        number: its new id.
        baud_rate: its new baud rate, bit/s.
        say: prints a line.
    """
    model = servos.model_of(found.number, found.identity)
    servos.answer_all(bus, found.number, model)
    servo, _ = servos.read_servo(bus, found.number, model, found.identity.firmware)
    if servos.registers(bus, servo, "torque_enable")["torque_enable"]:
        raise ConfigurationError(
            f"servo {servo.number} has its torque on: switch its supply off and on, then repeat"
        )
    for name, raw in {**servos.new_limits(model), "return_delay_time": 0}.items():
        _change(bus, servo, name, raw, say)
    _change(bus, servo, "id", number, say)
    _change(bus, replace(servo, number=number), "baud_rate", BAUD_RATES.index(baud_rate), say)


def _change(bus: ServoBus, servo: Servo, name: str, raw: int, say: Say) -> None:
    """Write a register if it differs, and read it back: a new id from the new id, a new baud rate at the new rate."""
    before = servos.registers(bus, servo, name)[name]
    if before == raw:
        say(f"  {name}: {raw}")
        return
    # The answer to a write of id or baud rate may be lost, and then no repetition reaches the servo.
    with contextlib.suppress(NoReplyError):
        bus.write(servo.number, servo[name], raw)
    if name == "id":
        servo = replace(servo, number=raw)
    if name == "baud_rate":
        bus.set_baud_rate(BAUD_RATES[raw])
    stored = servos.registers(bus, servo, name)[name]
    if stored != raw:
        raise CorruptReplyError(
            f"servo {servo.number} has {stored} in {name}, not the {raw} that was written: call setup_servo again"
        )
    say(f"  {name}: {before} -> {raw}, verified")


def _parser() -> Parser:
    parser = Parser(
        prog="setup_servo",
        description="Give the only servo on the bus its id and baud rate, no return delay, and the limits that the "
        "driver needs. After an interruption, call it again.",
    )
    parser.add_argument(
        "id", type=within(0, HIGHEST_ID, int), help="new id, 0 to 252, as in the driver's file"
    )
    parser.add_argument("--port", default="/dev/worm_bus", help="serial port; default: %(default)s")
    parser.add_argument(
        "--baud-rate",
        type=int,
        default=1_000_000,
        choices=BAUD_RATES,
        help="new baud rate, bit/s; default: %(default)s",
    )
    parser.add_argument("--yes", action="store_true", help="write without a question")
    return parser


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _agreed(options: argparse.Namespace, found: FoundServo) -> bool:
    model = servos.model_of(found.number, found.identity)
    _say(
        f"servo {found.number} ({model.name}, firmware {found.identity.firmware}) at {found.baud_rate} bit/s becomes "
        f"servo {options.id} at {options.baud_rate} bit/s, without return delay, with the factory limits"
    )
    try:
        return options.yes or input("write? [y/N] ").strip().lower() in ("y", "yes")
    except EOFError:
        return False


def _run(options: argparse.Namespace) -> int:
    bus = ServoBus.open(options.port, options.baud_rate)
    with contextlib.closing(bus):
        found = find_only_servo(bus, _say)
        if not _agreed(options, found):
            _say("nothing was written")
            return FAILED
        with bus.retrying():
            set_up(bus, found, options.id, options.baud_rate, _say)
    _say(f"servo {options.id} is set up; the driver's file needs baud_rate {options.baud_rate}")
    return DONE


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)
