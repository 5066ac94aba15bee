# SPDX-License-Identifier: Apache-2.0
"""How processes with ROS begin and end."""

import os
import signal
from collections.abc import Iterator

import pytest

rclpy = pytest.importorskip("rclpy", reason="no ROS is installed")

from worm_msgs.ros_process import ros_process  # noqa: E402

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


@pytest.fixture(autouse=True)
def _signals_put_back() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_asks_to_end_and_leaves_the_context_usable(ros_domain, number):
    with ros_process(["test"]) as ended:
        assert not ended()
        os.kill(os.getpid(), number)
        assert ended()
        rclpy.create_node("last_words").destroy_node()
    assert not rclpy.ok()
    os.kill(os.getpid(), number)  # changes nothing any more


def test_a_process_that_was_not_asked_gets_its_signals_back(ros_domain):
    before = [signal.getsignal(number) for number in SIGNALS]
    with ros_process(["test"]):
        assert [signal.getsignal(number) for number in SIGNALS] != before
    assert [signal.getsignal(number) for number in SIGNALS] == before


def test_every_further_signal_is_told(ros_domain):
    told: list[int] = []
    with ros_process(["test"]) as ended:
        ended.again = lambda: told.append(1)
        for count in range(3):
            assert len(told) == max(0, count - 1)
            os.kill(os.getpid(), signal.SIGTERM)
    assert len(told) == 2


def test_what_is_raised_inside_gets_out_with_ros_ended(ros_domain):
    with pytest.raises(ZeroDivisionError), ros_process(["test"]):
        raise ZeroDivisionError
    assert not rclpy.ok()
