# SPDX-License-Identifier: Apache-2.0
"""A bag played onto topics; the tests of the twin node play one to a live twin."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from harness import LATCHED, Probe, Processes
from recorded_run import EPOCH, simulated_run, write_bag
from rosgraph_msgs.msg import Clock

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import topic_of
from worm_model.nodes.play_node import _is_of_twin
from worm_msgs.msg import GaitState, Power, Tracker

TIMEOUT_S = 40.0
RUN = simulated_run()


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_bag(tmp_path / "bag", RUN)


def stamp(message) -> int:
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def clock(message: Clock) -> int:
    return message.clock.sec * 10**9 + message.clock.nanosec


def test_everything_is_published_in_order_with_the_bags_time(
    processes: Processes, probe: Probe, bag: Path
):
    trackers = probe.collect(Tracker, "tracker")
    powers = probe.collect(Power, "power")
    states = probe.collect(GaitState, "gait_state", LATCHED)
    clocks = probe.collect(Clock, "/clock")
    player = processes.start_executable("worm_model", "play", str(bag), "--rate", "5")
    probe.wait_for(lambda: player.exit_code is not None, "end of the bag")
    probe.wait_for(lambda: len(powers) == len(RUN.power.stamp), "all power samples")
    probe.wait_for(lambda: len(trackers) == len(RUN.tracker.stamp), "all positions")
    assert player.exit_code == 0
    assert [stamp(m) for m in trackers] == RUN.tracker.stamp.tolist()
    assert np.array_equal(
        [m.rear_position for m in trackers], RUN.tracker.rear_position, equal_nan=True
    )
    assert [m.power for m in powers] == RUN.power.power.tolist()
    last = RUN.gait_state.stamp[-1]
    probe.wait_for(lambda: states and stamp(states[-1]) == last, "the last state")
    assert states[-1].state == RUN.gait_state.state[-1]
    times = [clock(m) for m in clocks]
    assert times == sorted(times)
    assert len(times) > 20
    assert times[0] == EPOCH
    assert times[-1] <= RUN.power.stamp[-1] + 10**9


def test_a_late_subscriber_gets_the_last_state_of_latched_topics(
    processes: Processes, probe: Probe, bag: Path
):
    """Playing is so slow that no state follows the last one before the start."""
    clocks = probe.collect(Clock, "/clock")
    slow = ("--rate", "0.01", "--start", "6")
    processes.start_executable("worm_model", "play", str(bag), *slow)
    start = int(RUN.origin) + 6 * 10**9
    probe.wait_for(lambda: clocks, "a clock that stands")
    probe.wait_for(lambda: any(clock(m) > start for m in clocks), "the start")
    states = probe.collect(GaitState, "gait_state", LATCHED)
    probe.wait_for(lambda: states, "a state")
    reported = len(clocks)
    probe.wait_for(lambda: len(clocks) > reported + 50, "time in which another would have come")
    last = RUN.gait_state.stamp[start >= RUN.gait_state.stamp][-1]
    assert [stamp(m) for m in states] == [last]


def test_invalid_topics_are_left_out_and_reported(
    processes: Processes, probe: Probe, tmp_path: Path
):
    """A type without a name, a topic name that ROS rejects, and a message that is cut short."""
    power = topic_of("/worm/power", "worm_msgs/msg/Power")
    samples = encode(power, 3, {"power": np.arange(3.0)}, {})
    with new_bag(tmp_path / "bag") as writer:
        writer.write(Topic("/a", "", 0, "", "", "cdr"), b"\0\1\0\0" + bytes(4), 1, 1)
        writer.write(replace(power, name="/../x"), samples[0], 2, 2)
        writer.write(power, samples[0], 3, 3)
        writer.write(power, samples[1][:-8], 4, 4)
        writer.write(power, samples[2], 5, 5)
    powers = probe.collect(Power, "power")
    player = processes.start_executable("worm_model", "play", str(tmp_path / "bag"))
    probe.wait_for(lambda: player.exit_code is not None, "end of the bag", TIMEOUT_S)
    probe.wait_for(lambda: len(powers) == 2, "the whole samples")
    assert [m.power for m in powers] == [0.0, 2.0]
    assert player.exit_code == 0
    assert "'/a' is not played" in player.output()
    assert "'/../x' is not played: " in player.output()
    assert "/worm/power is played without the messages that are not as long" in player.output()
    assert "2 messages published" in player.output()


def test_it_starts_in_the_middle_and_again_at_the_end_until_it_is_stopped(
    processes: Processes, probe: Probe, bag: Path
):
    clocks = probe.collect(Clock, "/clock")
    powers = probe.collect(Power, "power")
    probe.node.create_publisher(Tracker, "tracker", 1)  # another source of positions
    options = ("--start", "3", "--rate", "10", "--loop")
    player = processes.start_executable("worm_model", "play", str(bag), *options)
    player.wait_for_line("/tracker is also published by ", TIMEOUT_S)

    def jumps() -> int:
        times = [clock(m) for m in clocks]
        return sum(later < earlier for earlier, later in pairwise(times))

    probe.wait_for(lambda: jumps() >= 2, "the third round")
    expected = RUN.power.stamp[RUN.power.stamp >= EPOCH + 3 * 10**9].tolist()
    probe.wait_for(lambda: len(powers) >= len(expected), "the later samples")
    assert [stamp(m) for m in powers[: len(expected)]] == expected
    player.interrupt()
    assert player.wait(TIMEOUT_S) == 0
    assert "messages published" in player.last_line()
    assert "Traceback" not in player.output()


def test_topics_of_the_twin_are_left_out_for_the_twin():
    own = "/worm/twin/state", "/a/b/body_length/estimated", "/worm/tf", "/diagnostics"
    others = "/worm/body_length/measured", "/worm/tracker", "/worm/tf_static"
    assert [_is_of_twin(name) for name in (*own, *others)] == [True] * 4 + [False] * 3
