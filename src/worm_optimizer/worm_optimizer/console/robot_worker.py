# SPDX-License-Identifier: Apache-2.0
"""The console's hands: a thread that owns the operator and does one thing after the other, and one that only stops."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass

from worm_model.errors import InputError
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.robot_telemetry import Telemetry
from worm_optimizer.operation.bring_up import FAILURES, Say
from worm_optimizer.snapshot import Snapshot

_POLL_S = 1.0

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
        robot: opens the operator that does all; is given who to tell what goes on meanwhile.
        brake: opens another one, which only stops: whatever the first one waits for.
        tell: gets each word, from either thread.

    Attributes:
        busy: what is being done, empty: nothing.
        failure: why there is no robot any more, empty: there is.
        stopped: whether somebody has pressed STOP since the last thing was asked for.
    """

    def __init__(
        self,
        robot: Callable[[Say], AbstractContextManager[OperatorNode]],
        brake: Callable[[], AbstractContextManager[OperatorNode]],
        tell: Callable[[Notice], None],
    ) -> None:
        self._robot, self._brake, self._tell = robot, brake, tell
        self._asked: Act | None = None
        self._ended = threading.Event()
        self._pulled = threading.Event()
        self._telemetry: Telemetry | None = None
        self.busy = "starting"
        self.failure = ""
        self.stopped = False
        self._threads = [threading.Thread(target=work) for work in (self._attend, self._stand_by)]

    def start(self) -> None:
        """Begin."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End, and wait for the end of what was started."""
        self._ended.set()
        for thread in self._threads:
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
        self.stopped = False
        self.busy, self._asked = doing, act
        return True

    def stop(self) -> None:
        """Hold the robot where it is, at once; what is being run is not wanted any more."""
        self.stopped = True
        self._pulled.set()

    # --- the thread that does all ------------------------------------------------------------

    def _attend(self) -> None:
        try:
            with self._robot(self._say) as node:
                self._telemetry = Telemetry(node)
                self.busy = ""
                while not self._ended.is_set():
                    node.wait(lambda: self._ended.is_set() or self._asked is not None, _POLL_S)
                    self._do(node)
        except _ClosedError:
            pass
        except FAILURES as error:
            self.failure = str(error)
            self._tell(Notice(self.failure, good=False))
        self.busy = ""

    def _say(self, text: str) -> None:
        self.busy = text
        self._tell(Notice(text))
        if self._ended.is_set():
            raise _ClosedError

    def _do(self, node: OperatorNode) -> None:
        act, self._asked = self._asked, None
        if act is None:
            return
        try:
            self._tell(Notice(act(node)))
        except (*FAILURES, InputError) as error:
            self._tell(Notice(str(error), good=False))
        finally:
            self.busy = ""

    # --- the thread that stops ---------------------------------------------------------------

    def _stand_by(self) -> None:
        try:
            with self._brake() as node:
                node.prepare_stop()
                while not self._ended.is_set():
                    if node.wait(lambda: self._ended.is_set() or self._pulled.is_set(), _POLL_S):
                        self._hold(node)
        except FAILURES as error:
            self._tell(Notice(f"STOP does not work: {error}", good=False))

    def _hold(self, node: OperatorNode) -> None:
        if not self._pulled.is_set():
            return
        self._pulled.clear()
        try:
            self._tell(Notice(node.stop()))
        except FAILURES as error:
            self._tell(Notice(f"{error}; a run ends without its heartbeat", good=False))
