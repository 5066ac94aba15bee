# SPDX-License-Identifier: Apache-2.0
"""Rows on the computer."""

import shutil
from types import SimpleNamespace

import pytest
from driver_rig import Clock, settings

from worm_driver.control import computer_check as computer
from worm_driver.control.bench_check import AdviceError, judge
from worm_driver.control.real_time import Scheduling
from worm_driver.driver_errors import ConfigurationError, PortError
from worm_msgs.claim import DRIVER, ROBOT, claim

DOMAIN = 231


class LateClock(Clock):
    """Clock of a computer that wakes a thread late, s."""

    def __init__(self, late: float) -> None:
        super().__init__()
        self._late = late

    def sleep_until(self, due: float) -> None:
        self.now = due + self._late * (round(due * 100) % 2)


def trial(late: float, exchange=lambda: None) -> computer.RateTrial:
    made = computer.RateTrial(settings(), exchange)
    made._clock = LateClock(late)
    return made


def test_a_punctual_and_a_late_computer():
    assert "100 Hz" in trial(0.0).result()
    with pytest.raises(AdviceError, match=r"late.*: free the machine"):
        trial(0.004).result()


def test_a_missing_real_time_permission_is_a_warning(monkeypatch):
    refused = Scheduling(granted=False, description="no SCHED_FIFO 40 (refused): grant it")
    monkeypatch.setattr(computer, "request_scheduling", lambda _: refused)
    row = judge("rate", [trial(0.0).result])
    assert (row.state.value, row.remedy) == ("warning", "grant it")


def test_a_port_that_vanishes_during_the_trial_is_a_failure():
    def unplugged() -> None:
        raise PortError("servo bus is gone: connect it")

    row = judge("rate", [trial(0.0, unplugged).result])
    assert (row.state.value, row.remedy) == ("failed", "connect it")


@pytest.mark.parametrize(
    ("free", "error"), [(5e9, None), (1e9, AdviceError), (1e6, ConfigurationError)]
)
def test_the_disk(monkeypatch, tmp_path, free, error):
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    if error is None:
        assert "5.0 GB" in computer.disk(tmp_path)
        return
    with pytest.raises(error, match="make room"):
        computer.disk(tmp_path)


def test_the_clock():
    assert "2026-11-28" in computer.clock(1_795_860_000.0, 0)
    with pytest.raises(AdviceError, match="set-ntp"):
        computer.clock(1_795_860_000.0, 5)
    with pytest.raises(ConfigurationError, match="1970"):
        computer.clock(60.0, 0)
    assert computer.clock_status() in range(6)


def test_the_ros_domain():
    assert "7, reachable from this machine" in computer.ros_domain({"ROS_DOMAIN_ID": "7"})
    with pytest.raises(AdviceError, match="every host"):
        computer.ros_domain({"WORM_NETWORK": "1"})
    for wrong in ({"ROS_DOMAIN_ID": "500"}, {"WORM_NETWORK": "x"}, {"RMW_IMPLEMENTATION": "rmw_x"}):
        row = judge("ROS domain", [lambda wrong=wrong: computer.ros_domain(wrong)])
        assert row.state.value == "failed"
        assert row.remedy


@pytest.mark.parametrize("role", [DRIVER, ROBOT])
def test_another_graph(role):
    computer.other_graph("/worm", DOMAIN, (DRIVER, ROBOT))
    with claim(role, "/worm", DOMAIN):
        row = judge("graph", [lambda: computer.other_graph("worm", DOMAIN, (DRIVER, ROBOT))])
        assert (row.state.value, "ROS_DOMAIN_ID" in row.remedy) == ("failed", True)
        computer.other_graph("/other", DOMAIN, (DRIVER, ROBOT))
