# SPDX-License-Identifier: Apache-2.0
"""Started processes: their output, their end, and that none remains."""

import os
import signal
import subprocess
import sys
import textwrap
import threading

import pytest

from worm_optimizer.operation.processes import (
    ProcessError,
    ProcessGroup,
    termination_as_interrupt,
    wait_for,
)

OBEDIENT = """
    import signal, sys, time
    def end(*_):
        print("ending", flush=True)
        sys.exit(0)
    signal.signal(signal.SIGINT, end)
    print("ready: here", flush=True)
    while True:
        time.sleep(0.1)
"""
DEAF = """
    import signal, subprocess, sys, time
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    print("child", child.pid, flush=True)
    time.sleep(600)
"""


STUBBORN = """
    import signal, sys, time
    def end(number, _):
        print("received", number, flush=True)
        if number == signal.SIGTERM:
            sys.exit(0)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, end)
    print("ready", flush=True)
    while True:
        time.sleep(0.1)
"""


def python(code: str) -> list[str]:
    return [sys.executable, "-c", textwrap.dedent(code)]


def is_running(pid: int) -> bool:
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True)
    return bool(state.stdout.strip()) and not state.stdout.startswith("Z")


def test_a_process_ends_on_the_interrupt_at_the_end_of_the_group(tmp_path):
    with ProcessGroup(tmp_path) as group:
        process = group.start("one", python(OBEDIENT))
        assert process.wait_for_line(r"^ready: (\w+)", 20.0)[1] == "here"
        group.check()
    assert process.exit_code == 0
    assert process.last_line() == "ending"


def test_a_line_counts_when_it_is_whole_or_its_process_has_ended(tmp_path):
    go_on = tmp_path / "go_on"
    code = f"""
        import pathlib, time
        print("ready: he", end="", flush=True)
        while not pathlib.Path({str(go_on)!r}).exists():
            time.sleep(0.01)
        print("re", flush=True)
        print("end: 5", end="", flush=True)
    """
    with ProcessGroup(tmp_path) as group:
        process = group.start("one", python(code))
        assert wait_for(lambda: process.output() == "ready: he", 20.0)
        with pytest.raises(ProcessError, match="no line"):
            process.wait_for_line(r"^ready: (\w+)", 0.0)
        go_on.touch()
        assert process.wait_for_line(r"^ready: (\w+)", 20.0)[1] == "here"
        assert process.wait_for_line(r"^end: (\d+)", 20.0)[1] == "5"


def test_a_deaf_process_is_killed_with_its_children(tmp_path):
    group = ProcessGroup(tmp_path)
    process = group.start("deaf", python(DEAF), grace_s=0.1)
    child = int(process.wait_for_line(r"^child (\d+)", 20.0)[1])
    group.stop()
    assert process.wait(5.0) == -signal.SIGKILL
    with pytest.raises(
        ProcessError, match=r"deaf did not end within 0\.1 s and was killed; .*deaf\.log"
    ):
        group.check()
    assert wait_for(lambda: not is_running(child), 5.0)


def test_a_further_signal_is_passed_on_to_the_process_that_is_ending_and_kills_none(tmp_path):
    group = ProcessGroup(tmp_path)
    first, last = (group.start(name, python(STUBBORN)) for name in ("first", "last"))
    for process in (first, last):
        process.wait_for_line("^ready", 20.0)

    def interrupt_again() -> None:
        for process in (last, first):
            for number in (signal.SIGINT, signal.SIGTERM):
                process.wait_for_line("^received 2", 20.0)
                os.kill(os.getpid(), number)

    operator = threading.Thread(target=interrupt_again)
    operator.start()
    group.stop()
    operator.join()
    assert [process.exit_code for process in (first, last)] == [0, 0]


def test_an_ended_process_keeps_its_id_until_the_end_of_the_group(tmp_path):
    with ProcessGroup(tmp_path) as group:
        process = group.start("short", python("pass"))
        assert process.wait(20.0) == 0
        os.kill(process.pid, 0)  # a zombie: no other process can get the id
        process.interrupt()
    with pytest.raises(ChildProcessError):
        os.waitpid(process.pid, os.WNOHANG)
    process.interrupt()  # harmless, whichever process has the id now
    assert process.exit_code == 0


def test_a_failed_process_is_reported_with_its_last_line(tmp_path):
    with ProcessGroup(tmp_path) as group:
        process = group.start("bad", python("import sys; sys.exit('no such port')"))
        process.wait(20.0)
        with pytest.raises(ProcessError, match="bad ended with exit status 1: no such port"):
            group.check()
        killed = group.start("killed", python(OBEDIENT))
        killed.wait_for_line("ready", 20.0)
        killed.kill()
        killed.wait(20.0)
        assert killed.report() == "killed ended with exit status -9 (SIGKILL)"
        with pytest.raises(
            ProcessError, match=r"bad ended with exit status 1: no such port; .*'ready'"
        ):
            process.wait_for_line("ready", 20.0)


def test_nothing_outlives_a_killed_parent(tmp_path):
    parent = f"""
        import pathlib, sys, time
        from worm_optimizer.operation.processes import ProcessGroup
        group = ProcessGroup(pathlib.Path({str(tmp_path)!r}))
        process = group.start("one", {python(OBEDIENT)!r})
        process.wait_for_line("ready", 20.0)
        print(process.pid, flush=True)
        time.sleep(600)
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(python(parent), stdout=subprocess.PIPE, text=True, env=environment) as it:
        assert it.stdout is not None
        pid = int(it.stdout.readline())
        it.kill()
    assert wait_for(lambda: not is_running(pid), 10.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_every_request_to_end_is_an_interrupt_while_it_lasts(number: signal.Signals):
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), termination_as_interrupt():
        os.kill(os.getpid(), number)
    assert signal.getsignal(number) is before
