# SPDX-License-Identifier: Apache-2.0
"""``worm_model watch``: live terminal view as a ROS node without publishers."""

from __future__ import annotations

import argparse
import math
import os
import select
import shutil
import sys
import termios
import time
import tty
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.qos import QoSProfile

from worm_model.commands.command_line import InputError, Parser, run_command
from worm_model.gait import (
    GaitError,
    gait_of,
)
from worm_model.parameters import load_parameters
from worm_model.run import Activity, LengthSource, nanoseconds
from worm_model.twin.data.records import Health
from worm_model.twin.watch_view import CLEAR, NAN, STALE_S, Trend, View, render
from worm_msgs.msg import BodyLength, GaitState, Power, Tracker, TwinResiduals, TwinState
from worm_msgs.node_command import declare_none
from worm_msgs.qos import LATCHED
from worm_msgs.ros_process import own_arguments, ros_process, spin

PERIOD_S = 0.2  # time between two drawings of the view
STORED = 200  # largest number of stored samples of an instrument: 2 s at 100 Hz
NAMESPACE = "/worm"
LEAST_WIDTH, MOST_WIDTH = 40, 120
KEYS = "q: quit   space: freeze or continue"
NO_KEYS = "Ctrl-C: quit"
NEWEST = QoSProfile(depth=1)


class WatchNode(Node):
    """Node that stores the newest message of each topic and draws the view several times a second.

    Attributes:
        view: newest values, except for those of tracker and power sensor (`seen` adds them).
        closed: True after the key q.
    """

    def __init__(self, pitch: float, namespace: str) -> None:
        super().__init__("watch", namespace=namespace)
        declare_none(self)
        self._pitch = pitch
        self.view = View()
        self.closed = False
        self._frozen = False
        self._differences: deque[float] = deque(maxlen=MOST_WIDTH)
        self._powers: deque[float] = deque(maxlen=MOST_WIDTH)
        self._second = 0
        self._received: dict[str, float] = {}
        self._stamp = 0  # ns, of the twin's newest state
        # The twin lags by its delay, so the view compares it with measurements of the same time.
        self._seen: deque[tuple[int, tuple[float, float]]] = deque(maxlen=STORED)
        self._measured: deque[tuple[int, float]] = deque(maxlen=STORED)
        self.create_subscription(TwinState, "twin/state", self._on_state, NEWEST)
        self.create_subscription(TwinResiduals, "twin/residuals", self._on_residuals, 100)
        self.create_subscription(Tracker, "tracker", self._on_tracker, NEWEST)
        self.create_subscription(Power, "power", self._on_power, NEWEST)
        self.create_subscription(GaitState, "gait_state", self._on_gait, LATCHED)
        self.create_subscription(BodyLength, "body_length/commanded", self._on_command, NEWEST)
        self.create_timer(PERIOD_S, self._draw, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def seen(self) -> View:
        """Return the present view, without the values of silent sources (`View.aged`).

        Measured values are those at the time of the twin's state. Without a live twin, they are the newest.
        """
        now = time.monotonic()
        ages = {name: now - last for name, last in self._received.items()}
        stamp = self._stamp if ages.get("twin", math.inf) <= STALE_S else None
        view = replace(
            self.view,
            robot=_nearest(self._seen, stamp, (NAN, NAN)),
            power=(self.view.power[0], _nearest(self._measured, stamp, NAN)),
        )
        return view.aged(ages)

    def _note(self, source: str) -> None:
        self._received[source] = time.monotonic()

    def _on_command(self, _: Any) -> None:
        self._note("driver")

    def _on_state(self, message: Any) -> None:
        self._note("twin")
        self._stamp = nanoseconds(message.header.stamp)
        from worm_model.twin.run_margins import spare_of  # here: SciPy and Numba load slowly

        self.view = replace(
            self.view,
            source=LengthSource(message.length_source),
            twin=(message.rear_position, message.front_position),
            rear_anchor=message.rear_anchor,
            grooves=(message.rear_groove, message.front_groove),
            length=message.length,
            initial_length=message.initial_length,
            groove_phase=message.groove_phase,
            cable_force=message.cable_force,
            power=(message.power, NAN),
            energy=(message.energy, self.view.energy[1]),
            spare=spare_of(message),
        )

    def _on_residuals(self, message: Any) -> None:
        energy = self.view.energy
        if message.energy == message.energy:
            energy = (energy[0], message.energy)
        health = Health(message.health)
        self.view = replace(self.view, health=health, message=message.message, energy=energy)

    def _on_tracker(self, message: Any) -> None:
        self._note("tracker")
        place = message.rear_position, message.front_position
        self._seen.append((nanoseconds(message.header.stamp), place))

    def _on_power(self, message: Any) -> None:
        self._note("power")
        self._measured.append((nanoseconds(message.header.stamp), message.power))

    def _on_gait(self, message: Any) -> None:
        text = ""
        with suppress(GaitError):  # no gait
            gait = gait_of(message.gait)
            way = "forward" if gait.direction > 0 else "reverse"
            text = f"{1e3 * gait.stroke:.1f} mm at {gait.frequency:.3f} Hz {way}"
        self.view = replace(
            self.view,
            activity=Activity(message.state),
            gait=text,
            cycle=message.cycle,
            cycles=message.cycles,
        )

    def _draw(self) -> None:
        keys = pressed()
        self.closed = self.closed or "q" in keys
        self._frozen ^= keys.count(" ") % 2 == 1
        view = self.seen()
        self._remember(view)
        if self._frozen:
            return
        terminal = shutil.get_terminal_size()
        width = min(max(terminal.columns, LEAST_WIDTH), MOST_WIDTH)
        trend = Trend(tuple(self._differences), tuple(self._powers))
        lines = render(view, self._pitch, width, trend)[: max(terminal.lines - 2, 1)]
        lines.append(KEYS if sys.stdin.isatty() else NO_KEYS)
        sys.stdout.write(CLEAR + "\n".join(lines) + "\n")
        sys.stdout.flush()

    def _remember(self, view: View) -> None:
        """Store one value per second for the trends."""
        if int(time.monotonic()) != self._second:
            self._second = int(time.monotonic())
            self._differences.append(view.robot[0] - view.twin[0])
            self._powers.append(view.power[1])


def _nearest(samples: deque[tuple[int, Any]], stamp: int | None, default: Any) -> Any:
    """Return the value of the sample whose stamp is nearest to a stamp (ns); None: the newest sample.

    The result is ``default`` without samples.
    """
    if not samples:
        return default
    if stamp is None:
        return samples[-1][1]
    return min(samples, key=lambda sample: abs(sample[0] - stamp))[1]


@contextmanager
def keys_of_terminal() -> Iterator[None]:
    """Within the context, deliver keys without waiting for Enter. Do nothing if the input is not a terminal."""
    if not sys.stdin.isatty():
        yield
        return
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def pressed() -> str:
    """Return the keys pressed since the last call; empty if the input is not a terminal."""
    if not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0.0)[0]:
        return ""
    return os.read(sys.stdin.fileno(), 64).decode(errors="ignore")


def main() -> int:
    """Draw until Ctrl-C or q; return the exit status."""
    parser = Parser(
        prog="watch",
        description="Show robot and twin live as text. Keys: q quits, space freezes the view and continues it.",
    )
    parser.add_argument(
        "--namespace", default=NAMESPACE, help=f"namespace of the robot (default: {NAMESPACE})"
    )
    parser.add_parameters()
    return run_command(parser, _watch, own_arguments(sys.argv)[1:])


def _watch(options: argparse.Namespace) -> None:
    pitch = load_parameters(options.parameters).pitch
    with ros_process() as ended, keys_of_terminal():
        try:
            node = WatchNode(pitch, options.namespace)
        except InvalidNamespaceException as error:
            raise InputError(f"--namespace {options.namespace}: {error}") from None
        try:
            spin(node, lambda: ended() or node.closed)
        finally:
            node.destroy_node()


if __name__ == "__main__":
    sys.exit(main())
