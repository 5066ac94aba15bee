# SPDX-License-Identifier: Apache-2.0
"""Threads that command the robot for the pages of the console, so that a page never waits.

The command thread owns an operator node and executes one command after another. The stop thread owns a second operator
node. It receives the telemetry, and can stop the robot while the command thread is busy.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue

from worm_model.errors import InputError
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.operation.bring_up import FAILURES, Check, Say
from worm_optimizer.robot_commands import Snapshot

STOP_PRESSED = "STOP was pressed"  # reason of the cancellation of a command by a person
_POLL_S = 1.0  # longest wait of a thread for a command or a request, s
_JOIN_S = 0.1  # period of the checks while the console ends, s

Command = Callable[[OperatorNode], str]


class _AbortedError(RuntimeError):
    """The console ends or another command waits, and the thread must not wait any longer."""


@dataclass(frozen=True)
class Notice:
    """Message for the pages; ``good`` is False for an error."""

    text: str
    good: bool = True


class RobotWorker:
    """Command thread and stop thread.

    Args:
        open_robot: opens the operator node of the command thread. It calls its first argument with progress messages
            and its second argument repeatedly while it waits. Both may raise an exception to end the wait.
        open_stop: opens the operator node of the stop thread. It calls its argument repeatedly while it waits. The
            argument may raise an exception to end the wait.
        notify: called with each notice, from either thread.

    Attributes:
        busy: description of the present command; empty if there is none.
        failure: reason why a thread has failed and commands are impossible; empty if they are possible.
        cancellation: reason why the latest command must end; empty if it may continue.
        stopping: True from a call of `stop` until the driver has answered or an error is reported.
    """

    def __init__(
        self,
        open_robot: Callable[[Say, Check], AbstractContextManager[OperatorNode]],
        open_stop: Callable[[Check], AbstractContextManager[OperatorNode]],
        notify: Callable[[Notice], None],
    ) -> None:
        self._open_robot, self._open_stop, self._notify = open_robot, open_stop, notify
        self._commands: SimpleQueue[tuple[str, Command]] = SimpleQueue()
        self._quiet_commands: SimpleQueue[tuple[str, Command]] = SimpleQueue()
        self._next = ""  # description of the command that waits for the end of the present one
        self._closing = threading.Event()
        self._stop_requested = threading.Event()
        self._stop_node: OperatorNode | None = None
        self._has_driver = True
        self._starting, self._is_quiet = True, False  # a start or quiet command can be aborted
        self.busy = "starting"
        self.failure = ""
        self.cancellation = ""
        self.stopping = False
        self._command_thread = threading.Thread(target=self._guard, args=(self._run_commands, ""))
        text = "STOP does not work, so no command is executed: "
        self._stop_thread = threading.Thread(target=self._guard, args=(self._run_stop, text))

    def start(self) -> None:
        """Start both threads."""
        for thread in (self._stop_thread, self._command_thread):
            thread.start()

    def close(self, hold_now: Callable[[], bool]) -> None:
        """End both threads after a run has come to rest.

        Args:
            hold_now: polled until the run has come to rest. When it returns True, the robot holds where it is.
        """
        self.cancellation = "the console ends"
        self._closing.set()
        while self._command_thread.is_alive() and not hold_now():
            self._command_thread.join(_JOIN_S)
        if self._command_thread.is_alive():
            self._stop_requested.set()
        for thread in (self._command_thread, self._stop_thread):
            if thread.is_alive():
                thread.join()

    def snapshot(self) -> Snapshot:
        """Return the latest state of the robot. It contains no state of a driver that has ended."""
        node = self._stop_node
        if node is None:
            return Snapshot()
        known = node.telemetry.snapshot()
        return known if self._has_driver else replace(known, driver=None)

    @property
    def hindrance(self) -> str:
        """Reason why no command can begin at once; empty if one can."""
        return self.failure or ("wait for the end of the present command" if self.busy else "")

    def submit(self, description: str, command: Command) -> bool:
        """Submit a command, which waits for the end of the present one. Return False if another one waits already."""
        if self._next or self.failure:
            return False
        if self.busy:
            self._next = description
        else:
            self.busy, self.cancellation = description, ""
        self._commands.put((description, command))
        return True

    def submit_quietly(self, command: Command) -> None:
        """Submit a command that does not operate the robot. It reports no result.

        Other commands go first: they interrupt it, and it is executed again from its beginning.
        """
        self._quiet_commands.put(("", command))

    def stop(self) -> None:
        """Request the stop thread to hold the robot where it is, and end a run. Other commands continue."""
        self.cancellation = STOP_PRESSED
        self.busy = self.busy and f"{STOP_PRESSED}: a run ends"
        self.stopping = True
        self._stop_requested.set()

    def report(self, text: str) -> None:
        """Report the progress of the present command."""
        self.busy = text

    def _guard(self, work: Callable[[], None], prefix: str) -> None:
        """Run the work of a thread. If it fails, report the reason, because the pages would otherwise wait forever."""
        try:
            work()
        except _AbortedError:
            pass
        except FAILURES as error:
            self._fail(f"{prefix}{error}")
        except Exception as error:  # noqa: BLE001 (the pages must show every failure)
            traceback.print_exc()
            self._fail(f"{prefix}the console has failed, restart it: {error!r}")

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        if threading.current_thread() is self._command_thread:
            self.busy = ""
        self._notify(Notice(text, good=False))

    # --- the command thread ------------------------------------------------------------------

    def _run_commands(self) -> None:
        with self._open_robot(self._on_start_progress, self._check_commands) as node:
            self._starting = False
            self.busy = self._next
            while not self._closing.is_set():
                node.wait(lambda: self._closing.is_set() or not self._waiting.empty(), _POLL_S)
                self._execute(node)

    def _check_commands(self) -> None:
        closing, waiting = self._closing.is_set(), not self._commands.empty()
        if (self._starting and closing) or (self._is_quiet and (closing or waiting)):
            raise _AbortedError

    def _on_start_progress(self, text: str) -> None:
        """Report the progress of the start, or that a node was restarted. Between commands, `busy` stays empty."""
        if self.busy:
            self.busy = text
        self._notify(Notice(text))
        self._check_commands()

    @property
    def _waiting(self) -> SimpleQueue[tuple[str, Command]]:
        return self._quiet_commands if self._commands.empty() else self._commands

    def _execute(self, node: OperatorNode) -> None:
        try:
            description, command = self._waiting.get_nowait()
        except Empty:
            return
        if description:
            self.busy, self._next = description, ""
        self._is_quiet = not description
        try:
            result = command(node)
            if description:
                self._notify(Notice(result))
        except _AbortedError:
            self.submit_quietly(command)
        except (*FAILURES, InputError, OSError) as error:
            self._notify(Notice(str(error), good=False))
        finally:
            self._is_quiet = False
            if description:
                self.busy = self._next

    # --- the stop thread ---------------------------------------------------------------------

    def _run_stop(self) -> None:
        with self._open_stop(self._check_stop) as node:
            node.telemetry.subscribe_to_all()
            node.prepare_stop()
            self._stop_node = node
            was_lost = False
            while True:
                node.wait(self._stop_requested.is_set, _POLL_S)
                self._stop(node)
                self._has_driver = node.has_driver
                if node.has_lost_driver and not was_lost:
                    self._notify(Notice("the driver ended; torque may be on", good=False))
                was_lost = node.has_lost_driver

    def _check_stop(self) -> None:
        if self._closing.is_set() and not self._command_thread.is_alive():
            raise _AbortedError

    def _stop(self, node: OperatorNode) -> None:
        if not self._stop_requested.is_set():
            return
        self._stop_requested.clear()
        try:
            self._notify(Notice(node.stop()))
        except FAILURES as error:
            text = (
                f"STOP is not confirmed ({error}). The console sends no more heartbeats, so its run ends at the next "
                "point of rest. If the robot moves, use the switch in the supply"
            )
            self._notify(Notice(text, good=False))
        finally:
            self.stopping = self._stop_requested.is_set()
