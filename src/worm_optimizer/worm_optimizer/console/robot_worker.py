# SPDX-License-Identifier: Apache-2.0
"""The console's hands: a thread that owns the operator and does one thing after the other, and one that never waits.

The second one hears what is shown and stops, whatever the first one waits for.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from queue import Empty, SimpleQueue

from worm_model.errors import InputError
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.robot_telemetry import Telemetry
from worm_optimizer.operation.bring_up import FAILURES, Check, Say
from worm_optimizer.snapshot import Snapshot

_POLL_S = 1.0
_JOIN_S = 0.1

Act = Callable[[OperatorNode], str]


class _ClosedError(RuntimeError):
    """The console ends."""


@dataclass(frozen=True)
class Notice:
    """What is to be told, and whether all is well."""

    text: str
    good: bool = True


class RobotWorker:
    """Between pages, which never wait, and the robot.

    Args:
        robot: opens the operator that does all; is given who to tell what goes on meanwhile, and a check.
        brake: opens another one, which listens and stops: whatever the first one waits for; is given a check.
        tell: gets each word, from either thread.

    Attributes:
        busy: what is being done, empty: nothing.
        failure: why nothing can be done any more, empty: it can.
        stopped: why what was asked for last is not wanted any more, empty: it is.
    """

    def __init__(
        self,
        robot: Callable[[Say, Check], AbstractContextManager[OperatorNode]],
        brake: Callable[[Check], AbstractContextManager[OperatorNode]],
        tell: Callable[[Notice], None],
    ) -> None:
        self._robot, self._brake, self._tell = robot, brake, tell
        self._asked: SimpleQueue[Act] = SimpleQueue()
        self._ended = threading.Event()
        self._pulled = threading.Event()
        self._telemetry: Telemetry | None = None
        self._up = False
        self.busy = "starting"
        self.failure = ""
        self.stopped = ""
        self._hands = threading.Thread(target=self._guarded, args=(self._attend, ""))
        words = "STOP does not work, so nothing is begun: "
        self._stopper = threading.Thread(target=self._guarded, args=(self._stand_by, words))

    def start(self) -> None:
        """Begin."""
        for thread in (self._stopper, self._hands):
            thread.start()

    def close(self, impatient: Callable[[], bool]) -> None:
        """End, and wait for the end of what was started: what runs comes to rest, or is held once ``impatient``."""
        self.stopped = "the console ends"
        self._ended.set()
        while self._hands.is_alive() and not impatient():
            self._hands.join(_JOIN_S)
        if self._hands.is_alive():
            self._pulled.set()
        for thread in (self._hands, self._stopper):
            if thread.is_alive():
                thread.join()

    def snapshot(self) -> Snapshot:
        """What is known of the robot now."""
        return Snapshot() if self._telemetry is None else self._telemetry.snapshot()

    @property
    def hindrance(self) -> str:
        """Why nothing can be asked for now, empty: something can."""
        return self.failure or (f"wait: {self.busy}" if self.busy else "")

    def ask(self, doing: str, act: Act) -> bool:
        """Have something done; false where something hinders it."""
        if self.hindrance:
            return False
        self.stopped = ""
        self.busy = doing
        self._asked.put(act)
        return True

    def stop(self) -> None:
        """Hold the robot where it is, at once; what is being run is not wanted any more."""
        self.stopped = "STOP was pressed"
        self._pulled.set()

    def going(self, text: str) -> None:
        """How far something is that may be given up, from the thread that does it; it is where the console ends."""
        self.busy = text
        if self._ended.is_set():
            raise _ClosedError

    def _guarded(self, work: Callable[[], None], before: str) -> None:
        """A thread that ends says why: else whoever waits for it would wait for ever."""
        try:
            work()
        except _ClosedError:
            pass
        except FAILURES as error:
            self._fail(f"{before}{error}")
        except Exception as error:  # noqa: BLE001 (whatever it was, the pages must be told)
            traceback.print_exc()
            self._fail(f"{before}start the console anew, it has failed: {error!r}")

    def _fail(self, text: str) -> None:
        self.failure = self.failure or text
        self._tell(Notice(text, good=False))

    # --- the thread that does all ------------------------------------------------------------

    def _attend(self) -> None:
        with self._robot(self._say, self._give_up_start) as node:
            self._up = True
            self.busy = ""
            while not self._ended.is_set():
                node.wait(lambda: self._ended.is_set() or not self._asked.empty(), _POLL_S)
                self._do(node)

    def _give_up_start(self) -> None:
        if self._ended.is_set() and not self._up:
            raise _ClosedError

    def _say(self, text: str) -> None:
        """Also while nothing is done, as when a node starts again: no reason to be busy."""
        if self.busy:
            self.busy = text
        self._tell(Notice(text))
        self._give_up_start()

    def _do(self, node: OperatorNode) -> None:
        try:
            act = self._asked.get_nowait()
        except Empty:
            return
        try:
            self._tell(Notice(act(node)))
        except (*FAILURES, InputError, OSError) as error:
            self._tell(Notice(str(error), good=False))
        finally:
            self.busy = ""

    # --- the thread that listens and stops ---------------------------------------------------

    def _stand_by(self) -> None:
        with self._brake(self._give_up_stop) as node:
            self._telemetry = Telemetry(node)
            node.prepare_stop()
            lost = False
            while True:
                node.wait(self._pulled.is_set, _POLL_S)
                self._hold(node)
                if node.has_lost_driver and not lost:
                    self._tell(Notice("the driver ended; torque may be on", good=False))
                lost = node.has_lost_driver

    def _give_up_stop(self) -> None:
        """There is nothing to stop any more."""
        if self._ended.is_set() and not self._hands.is_alive():
            raise _ClosedError

    def _hold(self, node: OperatorNode) -> None:
        if not self._pulled.is_set():
            return
        self._pulled.clear()
        try:
            self._tell(Notice(node.stop()))
        except FAILURES as error:
            self._tell(Notice(f"{error}; a run ends without its heartbeat", good=False))
