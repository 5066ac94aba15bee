# SPDX-License-Identifier: Apache-2.0
"""Command line: operate a robot whose node graph is running."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Callable
from dataclasses import asdict

from worm_model.commands.command_line import (
    FAILED,
    InputError,
    Parser,
    executable,
    number,
    print_result,
)
from worm_model.text_table import labelled
from worm_optimizer.commands.operate_run import add_run, add_tune, check_run, check_tune, run, tune
from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.bring_up import FAILURES

Action = Callable[[OperatorNode, argparse.Namespace], int]
Check = Callable[[argparse.Namespace], None]


def _parser() -> Parser:
    parser = Parser(
        prog="operate",
        description="Operate a robot whose node graph is running (./worm start, or ros2 launch) through its public "
        "services, actions and topics.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)

    def add(name: str, action: Action, text: str, check: Check = lambda _: None) -> Parser:
        added: Parser = actions.add_parser(name, help=text, description=text)
        added.set_defaults(action=action, check=check)
        added.add_argument(
            "--namespace", default="worm", help="namespace of the robot (default: worm)"
        )
        added.add_argument(
            "--timeout",
            type=number,
            default=10.0,
            metavar="S",
            help="time to wait for a driver, s (default: 10)",
        )
        added.add_json()
        return added

    add("state", _state, "Print the state of the robot; exit status 1 without a driver.")
    home, off = "Define the present cable length as ΔL = 0", "torque must be off."
    for name, call, text in (
        ("home", OperatorNode.home, f"{home}; {off}"),
        ("activate", OperatorNode.activate, "Turn the torque on without motion."),
        ("deactivate", OperatorNode.deactivate, "Bring the robot to rest and turn its torque off."),
        ("stop", OperatorNode.stop, "Hold the cable at once where it is; the torque stays on."),
        ("reboot", OperatorNode.reboot, f"Restart the servos with a hardware error; {off}"),
    ):
        add(name, _simple(call), text)
    switch = add(
        "emergency_stop",
        _emergency_stop,
        "on: hold immediately and reject every start, also after a restart of the driver; off: withdraw and reset the "
        "emergency stop. A button that is still pressed turns it on again.",
    )
    switch.add_argument("switch", choices=("on", "off"))
    _add_fault(add("fault", _fault, "Rehearse a fault on the virtual robot."))
    add_run(
        add(
            "run",
            run,
            "Run a given gait (--stroke, --frequency) or a gait of the optimizer's front, by default that with the "
            "lowest cost of transport. Ctrl-C stops it at the next point of rest; a second Ctrl-C holds immediately.",
            check_run,
        )
    )
    add_tune(
        add(
            "tune",
            tune,
            "Run a gait as `run` does, measure its margin, and repeat with the next gait until a cycle keeps its "
            "grooves with the requested probability. Every run is recorded.",
            check_tune,
        )
    )
    return parser


def _add_fault(parser: Parser) -> None:
    parser.add_argument(
        "name", help="fault that `worm_driver virtual_robot --help` lists; clear ends all faults"
    )
    parser.add_argument("--target", type=int, default=0, help="id of the servo; default: any")
    parser.add_argument("--count", type=int, default=0, help="number of affected packets")
    parser.add_number("--delay", "S", "time until the fault begins, s", 0.0)
    parser.add_number("--duration", "S", "duration, s; 0: the default of the fault", 0.0)
    parser.add_number("--value", "X", "value of the fault; 0: the default of the fault", 0.0)


def _operate(options: argparse.Namespace) -> int:
    namespace = "/" + options.namespace.strip("/")
    if options.timeout <= 0.0:
        raise InputError(f"--timeout {options.timeout:g}: give a positive time in s")
    options.check(options)
    action: Action = options.action
    try:
        with operator(namespace, name=f"operate_{os.getpid()}") as node:
            node.wait_for_driver(options.timeout)
            return action(node, options)
    except FAILURES as error:
        print(f"operate: {error}", file=sys.stderr)  # noqa: T201
        return FAILED


def _done(options: argparse.Namespace, message: str) -> int:
    print_result(options, {"message": message}, message)
    return 0


def _state(node: OperatorNode, options: argparse.Namespace) -> int:
    """Print the state. A value that was not received is NaN, an empty text or 0."""
    lifecycle, now = node.lifecycle_state(), node.current_snapshot()
    driver = now.driver
    assert driver is not None
    health = "" if now.health is None else now.health.name.lower()
    content = {
        "lifecycle": lifecycle,
        **asdict(driver),
        "state": driver.state.name,
        "power": now.power,
        "rear_position": now.robot.rear_position,
        "health": health,
        "initial_length": 0.0 if now.twin is None else now.twin.initial_length,
    }
    activity = "stopped, holding" if driver.holding else driver.state.name.lower()
    rows = {
        "driver": lifecycle,
        "state": activity + (f": {driver.message}" if driver.message else ""),
        "homed": "yes" if driver.homed else "no",
        "emergency stop": "ON: nothing starts" if driver.emergency_stop else "off",
    }
    if driver.cycle:
        rows["cycle"] = f"{driver.cycle} of {driver.cycles}"
    if math.isfinite(now.power):
        rows["power"] = f"{now.power:.2f} W"
    if math.isfinite(now.robot.rear_position):
        rows["rear position"] = f"{1e3 * now.robot.rear_position:.1f} mm"
    if health:
        rows["health"] = health
    print_result(options, content, labelled(rows))
    return 0


def _simple(call: Callable[[OperatorNode], str]) -> Action:
    """Return an action that calls a method of the operator node and prints its message."""
    return lambda node, options: _done(options, call(node))


def _emergency_stop(node: OperatorNode, options: argparse.Namespace) -> int:
    stops = options.switch == "on"
    return _done(options, node.emergency_stop() if stops else node.reset_emergency_stop())


def _fault(node: OperatorNode, options: argparse.Namespace) -> int:
    names = ("name", "target", "delay", "duration", "count", "value")
    return _done(options, node.inject_fault(**{name: getattr(options, name) for name in names}))


main = executable(_parser, _operate)
