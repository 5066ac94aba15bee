# SPDX-License-Identifier: Apache-2.0
"""Processes, and groups of processes that end together."""

from __future__ import annotations

import contextlib
import ctypes
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

POLL_PERIOD_S = 0.02  # period of the checks in `wait_for`, s
GRACE_S = 30.0  # default time from an interrupt to a kill, s
ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_LIBC = ctypes.CDLL(None, use_errno=True)
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


class ProcessError(RuntimeError):
    """A process could not be started, ended too early or did not respond in time."""


def executable_command(package: str, executable: str) -> list[str]:
    """Return the command line of an executable of a package. It is located in the same way as by `ros2 run`."""
    try:
        prefix = Path(get_package_prefix(package))
    except PackageNotFoundError:
        raise ProcessError(f"package {package} is not installed: build the workspace") from None
    path = prefix / "lib" / package / executable
    if not path.is_file():
        raise ProcessError(f"package {package} has no executable {executable}: looked for {path}")
    return [sys.executable, str(path)]


def wait_for(condition: Callable[[], bool], timeout_s: float) -> bool:
    """Poll until the condition holds; return False at the timeout (s)."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(POLL_PERIOD_S)
    return True


class Process:
    """Process in its own POSIX session. Its output is appended to a file.

    After its end, the process remains a zombie until `release`. Until then, its id is not used again, so that a signal
    to its group cannot reach another process.

    Attributes:
        name: name of the process.
        command: command line.
        grace_s: time from an interrupt to a kill, s.
        overdue: True if the process was killed because it did not end in time.
    """

    def __init__(
        self, name: str, command: Sequence[str], log: Path, env: Mapping[str, str], grace_s: float
    ) -> None:
        self.name = name
        self.command = command
        self.grace_s = grace_s
        self.overdue = False
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
        """Process id. The process group has the same id."""
        return self._popen.pid

    @property
    def exit_code(self) -> int | None:
        """Exit status, or the negative number of the signal that ended the process; None while it runs."""
        if self._popen.returncode is not None:
            return self._popen.returncode
        end = os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if end is None:
            return None
        return end.si_status if end.si_code == os.CLD_EXITED else -end.si_status

    def output(self) -> str:
        """Return the output so far, standard output and standard error combined."""
        return self._log.read_text(errors="replace")

    def last_line(self) -> str:
        """Return the last line of the output that is not empty."""
        lines = [line for line in self.output().splitlines() if line.strip()]
        return lines[-1] if lines else "(no output)"

    def wait_for_line(self, pattern: str, timeout_s: float) -> re.Match[str]:
        """Wait until a whole line of the output matches a regular expression; return the match."""
        expression = re.compile(pattern, re.MULTILINE)

        def found() -> re.Match[str] | None:
            ended, output = self.exit_code is not None, self.output()
            return expression.search(output if ended else output.rpartition("\n")[0])

        wait_for(lambda: bool(found()) or self.exit_code is not None, timeout_s)
        match = found()
        if match is None:
            raise ProcessError(f"{self.report()}; no line of its output matches {pattern!r}")
        return match

    def ends_within(self, timeout_s: float) -> bool:
        """Wait for the end of the process; return False at the timeout (s)."""
        return wait_for(lambda: self.exit_code is not None, timeout_s)

    def wait(self, timeout_s: float) -> int:
        """Wait for the end of the process and return `exit_code`. Raises `ProcessError` at the timeout (s)."""
        self.ends_within(timeout_s)
        code = self.exit_code
        if code is None:
            message = f"{self.name} still runs after {timeout_s:g} s: {self.last_line()}"
            raise ProcessError(message)
        return code

    def release(self) -> None:
        """Kill the remaining processes of the group and free the process id."""
        if self._popen.returncode is None:
            self.kill()
            self._popen.wait()

    def interrupt(self) -> None:
        """Send SIGINT, like Ctrl-C."""
        self.signal(signal.SIGINT)

    def kill(self) -> None:
        """Send SIGKILL, which has the effect of a crash or a power cut."""
        self.signal(signal.SIGKILL)

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to the process group; without effect after `release`."""
        if self._popen.returncode is None:
            os.killpg(self.pid, number)

    def report(self) -> str:
        """Return the state of the process and its last line in one line."""
        if self.overdue:
            return (
                f"{self.name} did not end within {self.grace_s:g} s and was killed; see {self._log}"
            )
        code = self.exit_code
        if code is not None and code < 0:  # a signal ended it, of which its last line knows nothing
            return f"{self.name} ended with exit status {code} ({signal.Signals(-code).name})"
        state = "still runs" if code is None else f"ended with exit status {code}"
        return f"{self.name} {state}: {self.last_line()}"


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
    """Raise `KeyboardInterrupt` also on SIGTERM and SIGHUP, so that contexts can clean up."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    with _handling(interrupt):
        yield


@contextlib.contextmanager
def counted_interrupts() -> Iterator[Callable[[], int]]:
    """Count SIGINT, SIGTERM and SIGHUP instead of ending the process. Provide a function that returns the count."""
    count = 0

    def note(_number: int, _frame: FrameType | None) -> None:
        nonlocal count
        count += 1

    with _handling(note):
        yield lambda: count


class ProcessGroup(contextlib.AbstractContextManager["ProcessGroup"]):
    """Processes that end with this context, in the reverse order of their start.

    Args:
        log_folder: folder of the log files.
        env: environment of the processes; None: that of this process.
    """

    def __init__(self, log_folder: Path, env: Mapping[str, str] | None = None) -> None:
        self.log_folder = log_folder
        self.processes: dict[str, Process] = {}
        self._env = dict(os.environ if env is None else env)

    def start(self, name: str, command: Sequence[str], grace_s: float = GRACE_S) -> Process:
        """Start a process.

        Args:
            name: name of the process and of its log, unique in the group.
            command: command line.
            grace_s: time from an interrupt to a kill, s.
        """
        if name in self.processes:
            raise ProcessError(f"a process with the name {name} exists already")
        log = self.log_folder / f"{name}.log"
        process = Process(name, command, log, self._env, grace_s)
        self.processes[name] = process
        return process

    def restart(self, name: str) -> None:
        """Restart a process that has ended. Its output is appended to the same log."""
        ended = self.forget(name)
        self.start(name, ended.command, grace_s=ended.grace_s)

    def forget(self, name: str) -> Process:
        """Remove a process that has ended from the group, which then ignores its exit status, and return it."""
        ended = self.processes.pop(name)
        ended.release()
        return ended

    def check(self) -> None:
        """Raise `ProcessError` if a process has ended with an error."""
        for process in self.processes.values():
            if process.exit_code not in (None, 0):
                raise ProcessError(process.report())

    def end(self, name: str) -> None:
        """Interrupt a process, wait for its end, and remove it from the group.

        Raises `ProcessError` if it does not end in time, or if a process of the group has ended with an error.
        """
        process = self.processes[name]
        process.interrupt()
        process.wait(process.grace_s)
        self.check()
        self.forget(name)

    def stop(self) -> None:
        """Interrupt the processes in the reverse order of their start and wait for each. Then kill what still runs.

        In the main thread, further signals go to the process that is ending. So a second Ctrl-C reaches the driver,
        which then releases the torque. A driver that is killed leaves the torque on.
        """
        ending: list[Process] = []

        def pass_on(number: int, _frame: FrameType | None) -> None:
            for process in ending[-1:]:
                process.signal(signal.Signals(number))

        in_main_thread = threading.current_thread() is threading.main_thread()
        with _handling(pass_on) if in_main_thread else contextlib.nullcontext():
            try:
                for process in reversed(self.processes.values()):
                    if process.exit_code is None:
                        ending.append(process)
                        process.interrupt()
                        if not process.ends_within(process.grace_s):
                            process.overdue = True
                            process.kill()
            finally:
                for process in self.processes.values():
                    process.release()

    def __exit__(self, *_: object) -> None:
        self.stop()


def _interrupt_when_parent_dies() -> None:
    # A killed parent cannot interrupt its processes, so the kernel does.
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGINT)
