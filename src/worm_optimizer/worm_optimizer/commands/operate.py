# SPDX-License-Identifier: Apache-2.0
"""Command line: operate a robot whose node graph is running."""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from worm_model.commands.command_line import (
    FAILED,
    InputError,
    Parser,
    executable,
    number,
    print_result,
)
from worm_model.text_table import labelled
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions
from worm_msgs.gait import GAIT_DEFAULTS, WAVEFORM, Gait, gait_of
from worm_optimizer.commands.objective_options import add_objective, request_of_options
from worm_optimizer.nodes.operator_node import OPTIMIZER, OperatorNode, UnreachableError, operator
from worm_optimizer.operation.bring_up import CYCLES, FAILURES, ProgressLog
from worm_optimizer.operation.processes import counted_interrupts
from worm_optimizer.operation.recorded_run import new_bag, recorded
from worm_optimizer.robot_commands import GaitCommand, RunProgress, RunResult
from worm_optimizer.snapshot import Snapshot

_PROGRESS_S = 2.0  # shortest time between two lines of progress within a cycle, s
#: fields of the driver's state that `operate state` returns
_STATE = (
    *("holding", "homed", "emergency_stop", "cycle", "cycles"),
    *("stroke", "frequency", "direction", "message"),
)

Action = Callable[[OperatorNode, argparse.Namespace], int]


def _parser() -> Parser:
    parser = Parser(
        prog="operate",
        description="Operate a robot whose node graph is running (./worm start, or ros2 launch) through its public "
        "services, actions and topics.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)

    def add(name: str, action: Action, text: str) -> Parser:
        added: Parser = actions.add_parser(name, help=text, description=text)
        added.set_defaults(action=action)
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
    add(
        "home",
        _simple(OperatorNode.home),
        "Define the present cable length as ΔL = 0; torque must be off.",
    )
    add("activate", _simple(OperatorNode.activate), "Turn the torque on without motion.")
    add(
        "deactivate",
        _simple(OperatorNode.deactivate),
        "Bring the robot to rest and turn its torque off.",
    )
    add(
        "stop",
        _simple(OperatorNode.stop),
        "Hold the cable where it is, immediately; the torque stays on.",
    )
    add(
        "reboot",
        _simple(OperatorNode.reboot),
        "Restart the servos that report a hardware error; torque must be off.",
    )
    switch = add(
        "emergency_stop",
        _emergency_stop,
        "on: hold immediately and reject every start, also after a restart of the driver; off: reset the emergency "
        "stop. The driver rejects a reset while the latest message of a publisher on the topic emergency_stop is true.",
    )
    switch.add_argument("switch", choices=("on", "off"))
    _add_fault(add("fault", _fault, "Rehearse a fault on the virtual robot."))
    _add_run(
        add(
            "run",
            _run,
            "Run a given gait (--stroke, --frequency) or a gait of the optimizer's front, by default that with the "
            "lowest cost of transport. Ctrl-C stops it at the next point of rest; a second Ctrl-C holds immediately.",
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


def _add_run(parser: Parser) -> None:
    parser.add_gait()
    add_objective(parser)
    parser.add_conditions(None)
    ends = parser.add_argument_group("end of the run: the first that is reached")
    ends.add_argument(
        "--cycles", type=int, default=0, metavar="N", help=f"default {CYCLES} if no end is given"
    )
    ends.add_argument("--grooves", type=int, default=0, metavar="N", help="needs a tracker")
    ends.add_argument(
        "--distance", type=number, default=0.0, metavar="M", help="in m; needs a tracker"
    )
    parser.add_argument(
        "--record", type=Path, metavar="FOLDER", help="record the run into a new bag in this folder"
    )
    parser.add_parameters()


def _operate(options: argparse.Namespace) -> int:
    namespace = "/" + options.namespace.strip("/")
    if options.timeout <= 0.0:
        raise InputError(f"--timeout {options.timeout:g}: give a positive time in s")
    action: Action = options.action
    if action is _run:
        _ends(options, _own_gait(options) or Gait(0.05, 0.1))  # raises errors before any request
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
    lifecycle, now = node.lifecycle_state(), node.current_snapshot()
    content = _state_content(lifecycle, now)
    print_result(options, content, _state_text(content))
    return 0


def _state_content(lifecycle: str, now: Snapshot) -> dict[str, Any]:
    """Return the fields of the output. A value that was not received is NaN, an empty text or 0."""
    assert now.driver is not None
    return {
        "lifecycle": lifecycle,
        **{name: getattr(now.driver, name) for name in _STATE},
        "state": now.driver.state.name,
        "power": now.power,
        "rear_position": now.robot.rear_position,
        "health": "" if now.residuals is None else now.residuals.health.name.lower(),
        "initial_length": 0.0 if now.twin is None else now.twin.initial_length,
    }


def _state_text(content: Mapping[str, Any]) -> str:
    state = SimpleNamespace(**content)
    activity = "stopped, holding" if state.holding else state.state.lower()
    rows = {
        "driver": state.lifecycle,
        "state": activity + (f": {state.message}" if state.message else ""),
        "homed": "yes" if state.homed else "no",
        "emergency stop": "ON: nothing starts" if state.emergency_stop else "off",
    }
    if state.cycle:
        rows["cycle"] = f"{state.cycle} of {state.cycles}"
    if math.isfinite(state.power):
        rows["power"] = f"{state.power:.2f} W"
    if math.isfinite(state.rear_position):
        rows["rear position"] = f"{1e3 * state.rear_position:.1f} mm"
    if state.health:
        rows["health"] = state.health
    return labelled(rows)


def _simple(call: Callable[[OperatorNode], str]) -> Action:
    """Return an action that calls a method of the operator node and prints its message."""
    return lambda node, options: _done(options, call(node))


def _emergency_stop(node: OperatorNode, options: argparse.Namespace) -> int:
    stops = options.switch == "on"
    return _done(options, node.emergency_stop() if stops else node.reset_emergency_stop())


def _fault(node: OperatorNode, options: argparse.Namespace) -> int:
    names = ("name", "target", "delay", "duration", "count", "value")
    return _done(options, node.inject_fault(**{name: getattr(options, name) for name in names}))


def _run(node: OperatorNode, options: argparse.Namespace) -> int:
    say = ProgressLog("operate")
    conditions = _conditions(node, options, say)
    command = _ends(options, _own_gait(options) or _requested(node, options, say))
    new = None if options.record is None else new_bag(options.record)
    say(f"running {command}")
    recorder = (
        nullcontext()
        if new is None
        else recorded(node, new, options.parameters, conditions, str(os.getpid()))
    )
    with recorder as bag:
        result = _attended(node, command, say)
    content = {**asdict(result), "bag": None if bag is None else str(bag)}
    print_result(options, content, _result_text(result, bag))
    if not result.success:
        print(f"operate: {result.message}", file=sys.stderr)  # noqa: T201
    return 0 if result.success else FAILED


def _conditions(node: OperatorNode, options: argparse.Namespace, say: ProgressLog) -> Conditions:
    """Send the conditions in the options to twin and optimizer, and return the conditions of the optimizer.

    Without an optimizer, send nothing and return the conditions in the options. Do not search for one if neither a
    recording nor a requested gait depends on the conditions.
    """
    stated = {
        name: value for name in CONDITION_ROWS if (value := getattr(options, name)) is not None
    }
    if not stated and options.record is None and options.stroke is not None:
        return LEVEL
    if not node.graph.has_node(OPTIMIZER):
        say("no optimizer is running: the recording contains the conditions of the options")
        return Conditions(**stated)
    if stated:
        node.set_model_parameters(stated)
    conditions = node.conditions()
    if conditions != LEVEL:
        say(f"conditions: {conditions}")
    return conditions


def _own_gait(options: argparse.Namespace) -> Gait | None:
    """Return the gait that the options define; None if a gait must be requested instead. Raises `InputError`."""
    if options.stroke is None and options.frequency is None:
        for name in WAVEFORM:
            if name in GAIT_DEFAULTS and str(getattr(options, name)) != str(GAIT_DEFAULTS[name]):
                option = f"--{name.replace('_', '-')}"
                raise InputError(f"{option} needs a gait in numbers: give --stroke and --frequency")
        return None
    if options.stroke is None or options.frequency is None:
        raise InputError("a gait has a stroke and a frequency: give --stroke and --frequency")
    if (options.objective, options.speed, options.power) != (None, None, None):
        raise InputError(
            "--stroke and --frequency define the gait: omit --objective, --speed and --power"
        )
    return gait_of(options)


def _ends(options: argparse.Namespace, gait: Gait) -> GaitCommand:
    """Return a command for a gait with the ends in the options. Raises `InputError`.

    If the options contain no end, the run ends after `CYCLES` cycles.
    """
    default = 0 if options.grooves or options.distance else CYCLES
    return GaitCommand(gait, options.cycles or default, options.grooves, options.distance)


def _requested(node: OperatorNode, options: argparse.Namespace, say: ProgressLog) -> Gait:
    """Request a gait from the optimizer.

    The request contains the initial length in the twin's latest state, if there is a twin.
    """
    request = request_of_options(options)
    twin = node.current_snapshot().twin
    length = 0.0 if twin is None else twin.initial_length
    try:
        answer = node.request_gait(request, options.direction, length)
    except UnreachableError as error:
        raise InputError(str(error)) from None
    phase = 1e3 * answer.groove_phase
    say(f"{1e3 * answer.nominal_speed:.2f} mm/s expected at a groove phase of {phase:+.1f} mm")
    return answer.gait


def _attended(node: OperatorNode, command: GaitCommand, say: ProgressLog) -> RunResult:
    """Run a gait to its end. Ctrl-C stops it at the next point of rest; a second Ctrl-C holds immediately."""
    with counted_interrupts() as interrupts:
        run = node.begin(command)
        try:
            if not node.follow(run, _progress(say), lambda: interrupts() > 0):
                run.cancel()
                say("stopping at the next point of rest; Ctrl-C again holds immediately")
            if not node.follow(run, _progress(say), lambda: interrupts() > 1):
                say(node.stop())
            node.follow(run, _progress(say))
            return run.result
        finally:
            run.close()


def _progress(say: ProgressLog) -> Callable[[RunProgress], None]:
    last, cycle = -math.inf, -1

    def progress(now: RunProgress) -> None:
        nonlocal last, cycle
        if now.cycle != cycle or time.monotonic() > last + _PROGRESS_S:
            last, cycle = time.monotonic(), now.cycle
            say(str(now))

    return progress


def _result_text(result: RunResult, bag: Path | None) -> str:
    recording = {} if bag is None else {"recording": bag}
    if not result.cycles_completed:
        return f"{result.message}\n{labelled(recording)}".rstrip()
    rows = {
        "cycles": result.cycles_completed,
        "distance": f"{1e3 * result.distance:.1f} mm, {result.grooves:.1f} grooves",
        "speed": f"{1e3 * result.speed:.2f} mm/s",
        "power": f"{result.power:.2f} W, at rest {result.idle_power:.2f} W",
        "cost of transport": f"{result.cost_of_transport:.1f}",
        **recording,
    }
    return f"{result.message}\n{labelled(rows)}"


main = executable(_parser, _operate)
