# SPDX-License-Identifier: Apache-2.0
"""Start and end of processes with ROS."""

import os
import signal
from collections.abc import Iterator

import pytest
import rclpy

from worm_msgs.ros_process import ShutdownRequest, own_arguments, ros_process

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture(autouse=True)
def _signals_put_back() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_requests_the_end_and_leaves_the_context_usable(ros_domain, number):
    with ros_process(["test"]) as ended:
        assert not ended()
        os.kill(os.getpid(), number)
        assert ended()
        rclpy.create_node("last_words").destroy_node()
    assert not rclpy.ok()
    os.kill(os.getpid(), number)  # has no more effect


def test_a_process_without_a_signal_gets_its_handlers_back(ros_domain):
    before = [signal.getsignal(number) for number in SIGNALS]
    with ros_process(["test"]):
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert [signal.getsignal(number) for number in SIGNALS] == before


def test_only_a_later_ctrl_c_forces_the_end():
    """launch and systemd escalate with SIGTERM by themselves; a terminal and launch both forward one Ctrl-C."""
    now, reported = [10.0], []
    ending = ShutdownRequest(lambda: now[0])
    ending.again = lambda: reported.append(now[0])
    for time, number in (
        (10.0, signal.SIGINT),
        (11.0, signal.SIGINT),
        (20.0, signal.SIGTERM),
        (30.0, signal.SIGHUP),
    ):
        now[0] = time
        ending.on_signal(number, None)
    assert ending()
    assert reported == []
    for time in (40.0, 41.0):
        now[0] = time
        ending.on_signal(signal.SIGINT, None)
    assert reported == [40.0, 41.0]


def test_a_signal_interrupts_a_long_computation_and_those_after_it(ros_domain):
    with ros_process(["test"]) as ended:
        first = ended.first
        with ended.interrupting():
            pass
        assert ended.first is first
        with pytest.raises(KeyboardInterrupt), ended.interrupting():
            os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt), ended.interrupting():
            pytest.fail("a computation begins after the signal")
        os.kill(os.getpid(), signal.SIGINT)  # interrupts nothing outside of a computation


def test_a_ros_argument_that_cannot_be_used_is_one_line_and_status_2(ros_domain, capsys):
    arguments = ["test", "--ros-args", "--params-file", "/nope"]
    for use in (lambda: own_arguments(arguments), lambda: ros_process(arguments).__enter__()):
        with pytest.raises(SystemExit) as error:
            use()
        assert error.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "/nope" in line


def test_an_unavailable_setting_of_the_environment_is_one_line_and_status_2(
    ros_domain, capsys, monkeypatch, tmp_path
):
    with pytest.raises(SystemExit) as error, ros_process(["test"]):
        raise RuntimeError(
            "error creating node: no security\nlibraries, at /a/b.cpp:3, at /c/node.c:2"
        )
    assert error.value.code == 2
    assert capsys.readouterr().err == "ROS: error creating node: no security libraries\n"
    for name, value in {"KEYSTORE": str(tmp_path), "ENABLE": "true", "STRATEGY": "Enforce"}.items():
        monkeypatch.setenv(f"ROS_SECURITY_{name}", value)
    with pytest.raises(SystemExit), ros_process(["test"]):
        pass
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("ROS: ")
    assert str(tmp_path) in line


def test_what_is_raised_inside_gets_out_with_ros_ended(ros_domain):
    with pytest.raises(ZeroDivisionError), ros_process(["test"]):
        raise ZeroDivisionError
    assert not rclpy.ok()
