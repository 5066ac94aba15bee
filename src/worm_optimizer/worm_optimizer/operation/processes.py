# SPDX-License-Identifier: Apache-2.0
"""Processes that are started together and of which none is left behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType, TracebackType

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

POLL_PERIOD_S = 0.02
GRACE_S = 30.0  # from an interrupt to a kill; a driver brings its gait to rest within a cycle, if it gets a processor
ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_LIBC = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


class ProcessError(RuntimeError):
    """A process could not be started, ended too early or did not do in time what it should."""


def executable_command(package: str, executable: str) -> list[str]:
    """The command line of an installed executable, found as `ros2 run` finds it.

    Raises `ProcessError` if the package or the executable is not installed.
    """
    try:
        prefix = Path(get_package_prefix(package))
    except PackageNotFoundError:
        raise ProcessError(f"package {package} is not installed: build the workspace") from None
    path = prefix / "lib" / package / executable
    if not path.is_file():
        raise ProcessError(f"package {package} has no executable {executable}: looked for {path}")
    return [sys.executable, str(path)]


def wait_for(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Poll until the condition holds; false if it does not within the timeout (s)."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_PERIOD_S)
    return True


class Process:
    """One process in a session of its own, its output in a file.

    It stays a zombie after its end until `release`: so long its id, which is also that of its group,
    belongs to no other process, and a signal to the group cannot hit a stranger.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, env: Mapping[str, str]
    ) -> None:
        self.name = name
        self.command = command
        self._log = log
        with log.open("ab") as output:
            self._popen = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=dict(env),
                start_new_session=True,
                preexec_fn=_interrupt_when_parent_dies,
            )

    @property
    def pid(self) -> int:
        """Process id, which is also the id of its process group."""
        return self._popen.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs; the negative number of the signal that ended it."""
        if self._popen.returncode is not None:
            return self._popen.returncode
        end = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if end is None:
            return None
        return end.si_status if end.si_code == os.CLD_EXITED else -end.si_status

    def output(self) -> str:
        """What it has written so far, standard output and standard error together."""
        return self._log.read_text(errors="replace")

    def last_line(self) -> str:
        """The last line of its output that is not empty."""
        lines = [line for line in self.output().splitlines() if line.strip()]
        return lines[-1] if lines else "(no output)"

    def wait_for_line(self, pattern: str, timeout_s: float) -> re.Match[str]:
        """Wait until a line of the output matches; raises `ProcessError` if it does not."""
        expression = re.compile(pattern, re.MULTILINE)
        wait_for(
            lambda: bool(expression.search(self.output())) or self.exit_code is not None, timeout_s
        )
        match = expression.search(self.output())
        if match is None:
            raise ProcessError(
                f"{self.name} {self._state()} without {pattern!r}: {self.last_line()}"
            )
        return match

    def wait(self, timeout_s: float) -> int:
        """Wait for its end and return the exit code; raises `ProcessError` at the timeout."""
        wait_for(lambda: self.exit_code is not None, timeout_s)
        code = self.exit_code
        if code is None:
            message = f"{self.name} still runs after {timeout_s:g} s: {self.last_line()}"
            raise ProcessError(message)
        return code

    def release(self) -> None:
        """Kill what is left of its process group, and let go of its id."""
        if self._popen.returncode is None:
            self.kill()
            self._popen.wait()

    def interrupt(self) -> None:
        """Ask it to end, as Ctrl-C does."""
        self.signal(signal.SIGINT)

    def kill(self) -> None:
        """End it without asking, as a crash or a power cut does."""
        self.signal(signal.SIGKILL)

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to its process group; nothing happens once it is released."""
        if self._popen.returncode is None:
            os.killpg(self.pid, number)

    def _state(self) -> str:
        code = self.exit_code
        return "still runs" if code is None else f"ended with exit status {code}"


@contextlib.contextmanager
def _handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in ENDING_SIGNALS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


@contextlib.contextmanager
def termination_as_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise `KeyboardInterrupt`, as SIGINT does, so that nothing is left behind."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handling(interrupt):
        yield


@contextlib.contextmanager
def counted_interrupts() -> Iterator[Callable[[], int]]:
    """How often SIGINT, SIGTERM and SIGHUP came, which do nothing else meanwhile."""
    count = 0

    def note(_number: int, _frame: FrameType | None) -> None:
        nonlocal count
        count += 1

    with _handling(note):
        yield lambda: count


class ProcessGroup:
    """Processes that end with this context, in the reverse order of their start."""

    def __init__(self, log_folder: Path, env: Mapping[str, str] | None = None) -> None:
        self.log_folder = log_folder
        self.processes: dict[str, Process] = {}
        self._env = dict(os.environ if env is None else env)

    def start(self, name: str, command: Sequence[str]) -> Process:
        """Start a process under a name that no other has had."""
        if name in self.processes:
            raise ProcessError(f"there is a process {name} already")
        process = Process(name, command, self.log_folder / f"{name}.log", self._env)
        self.processes[name] = process
        return process

    def restart(self, name: str) -> None:
        """Start a process that has ended once more; its log goes on."""
        ended = self.forget(name)
        self.start(name, ended.command)

    def forget(self, name: str) -> Process:
        """Let go of a process that has ended: how it did no longer matters."""
        ended = self.processes.pop(name)
        ended.release()
        return ended

    def check(self) -> None:
        """Raise `ProcessError` if a process has ended with an error."""
        for process in self.processes.values():
            if process.exit_code not in (None, 0):
                raise ProcessError(f"{process.name} {process._state()}: {process.last_line()}")

    def end(self, name: str, grace_s: float = GRACE_S) -> None:
        """Interrupt one and wait; raises `ProcessError` if it does not end, or ends with an error."""
        process = self.processes[name]
        process.interrupt()
        process.wait(grace_s)
        self.check()

    def stop(self, grace_s: float = GRACE_S) -> None:
        """Interrupt all, one after the other, and kill what is left of each process group."""
        try:
            for process in reversed(self.processes.values()):
                if process.exit_code is None:
                    process.interrupt()
                    with contextlib.suppress(ProcessError):
                        process.wait(grace_s)
        finally:  # also on an impatient second Ctrl-C
            for process in self.processes.values():
                process.release()

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()


def _interrupt_when_parent_dies() -> None:
    # Even a killed parent, which cannot stop anything any more, leaves no process behind.
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
