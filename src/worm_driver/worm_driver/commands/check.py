# SPDX-License-Identifier: Apache-2.0
"""Command ``check``: a table of what can be known before torque is switched on, each row ok or with its remedy."""

import argparse
import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from worm_driver.clock import Clock, MachineClock
from worm_driver.commands.driver_command import run_command
from worm_driver.control import bench_check
from worm_driver.control.bench_check import Row, SensorCheck, ServoCheck, State, skipped
from worm_driver.control.computer_check import OF_REAL_TIME, computer_checks
from worm_driver.control.driver_settings import DriverSettings, load_body
from worm_driver.driver_errors import ConfigurationError
from worm_driver.servos.state_reader import STATE_SIZE, STATE_START
from worm_driver.simulated_clock import I2C, SERIAL, clock_of, is_virtual
from worm_msgs.claim import DRIVER, ROBOT
from worm_msgs.command_parser import DONE, FAILED, Parser
from worm_msgs.driver_file import DriverFile, read_driver_file

_COLOURS = {State.OK: 32, State.WARNING: 33, State.FAILED: 31, State.SKIPPED: 90}  # ANSI
_INDENT = 34  # columns before the text of a row


def _parser() -> Parser:
    parser = Parser(
        prog="check",
        description="Check the servo bus, the servos, the power sensor, the camera and the computer before torque is "
        "switched on. Print a table with a remedy for each problem. No register is written.",
    )
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help="parameter file of the driver; default: the default parameters",
    )
    parser.add_argument("--port", help="serial port, instead of that of the file")
    parser.add_argument("--i2c-bus", metavar="BUS", help="I2C bus, instead of that of the file")
    parser.add_argument(
        "--namespace", default="/worm", help="namespace of the driver; default: %(default)s"
    )
    parser.add_argument("--camera", metavar="DEVICE", help="camera, such as /dev/video0")
    parser.add_argument("--setup", type=Path, metavar="FILE", help="setup file of the tracker")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _settings(options: argparse.Namespace) -> DriverSettings:
    file = read_driver_file(options.file) if options.file else DriverFile()
    given = {"port": options.port, "i2c_bus": options.i2c_bus}
    file = replace(file, **{name: value for name, value in given.items() if value is not None})
    return DriverSettings(**vars(file), body=load_body(file.parameter_file))


def _camera(options: argparse.Namespace) -> Callable[[], list[Row]]:
    """Return the function that checks the camera. Raises ConfigurationError or SetupError for wrong options."""
    if options.camera is None and options.setup is None:
        return partial(skipped, bench_check.CAMERA_ROWS, "no --camera")
    if None in (options.camera, options.setup):
        raise ConfigurationError("--camera and --setup belong together: give both")
    # Imported here, because it takes too long for --help.
    from worm_driver.tracking.camera_check import camera_rows
    from worm_driver.tracking.tracker import Tracker
    from worm_driver.tracking.tracker_setup import load_setup

    return partial(camera_rows, Tracker(load_setup(options.setup)), options.camera)


def _rows(
    settings: DriverSettings, options: argparse.Namespace, camera: Callable[[], list[Row]]
) -> Iterator[Row]:
    bus, rows = bench_check.open_port(settings)
    yield from rows
    if bus is None:
        # Without the clock of a virtual robot, which may have a driver.
        yield from skipped(ServoCheck.NAMES, "the port cannot be opened")
        yield from _computer_rows(settings, options.namespace, MachineClock(), lambda: None)
    else:
        with contextlib.closing(bus), contextlib.closing(clock_of(settings.port, SERIAL)) as clock:
            bus.port.go_by(clock)
            check = ServoCheck(settings, bus)
            yield from check.rows()
            exchange = partial(bus.sync_read, STATE_START, STATE_SIZE, list(check.servos))
            yield from _computer_rows(settings, options.namespace, clock, exchange)
    # A thread with a virtual robot's clock may wait on this clock only, so the clock of the bus is closed by now.
    with contextlib.closing(clock_of(settings.i2c_bus, I2C)) as clock:
        yield from SensorCheck(settings, clock).rows()
    yield from camera()


def _computer_rows(
    settings: DriverSettings, namespace: str, clock: Clock, exchange: Callable[[], object]
) -> Iterator[Row]:
    roles = (DRIVER,) if is_virtual(settings.port) else (DRIVER, ROBOT)
    checks = computer_checks(settings, os.environ, namespace, roles, exchange)
    for name, check in checks.items():
        if clock.epoch_ns is not None and name in OF_REAL_TIME:
            yield from skipped([name], "the time of the virtual robot waits for the driver")
        else:
            yield bench_check.judge(name, [check])


def _print(row: Row) -> None:
    state = f"{row.state.value:8}"
    if sys.stdout.isatty():
        state = f"\033[{_COLOURS[row.state]}m{state}\033[0m"
    remedy = f"\n{'':{_INDENT}}-> {row.remedy}" if row.remedy else ""
    sys.stdout.write(f"{row.name:{_INDENT - 9}}{state} {row.found}{remedy}\n")
    sys.stdout.flush()


def _content(row: Row) -> dict[str, object]:
    state = {"ok": row.state is not State.FAILED, "state": row.state.value}
    return {"name": row.name, **state, "found": row.found, "remedy": row.remedy}


def _run(options: argparse.Namespace) -> int:
    camera = _camera(options)
    rows = []
    for row in _rows(_settings(options), options, camera):
        rows.append(row)
        if not options.json:
            _print(row)
    ok = all(row.state is not State.FAILED for row in rows)
    if options.json:
        content = {"ok": ok, "checks": [_content(row) for row in rows]}
        sys.stdout.write(json.dumps(content) + "\n")
    return DONE if ok else FAILED


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)
