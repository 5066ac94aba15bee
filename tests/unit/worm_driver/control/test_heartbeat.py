# SPDX-License-Identifier: Apache-2.0
"""Timeout of the client that requested a run."""

import math

from worm_driver.gait.run_end import PERIOD, HeartbeatMonitor, shorter_timeout


def test_an_owner_that_sends_heartbeats_is_not_silent():
    owner = HeartbeatMonitor(1.0, 0.0)
    for look in range(100):
        if look % 3 == 0:
            owner.record()
        assert not owner.is_silent(look * PERIOD)


def test_an_owner_without_heartbeats_is_silent_after_its_timeout():
    owner = HeartbeatMonitor(1.0, 0.0)
    silent = [owner.is_silent(look * PERIOD) for look in range(1, 15)]
    assert silent == [look * PERIOD > 1.0 + 1e-9 for look in range(1, 15)]


def test_the_drivers_own_pause_is_not_its_owners_silence():
    owner = HeartbeatMonitor(1.0, 0.0)
    assert not owner.is_silent(30.0)


def test_the_shorter_timeout_holds():
    assert (
        shorter_timeout(2.0, 0.0) == shorter_timeout(0.0, 2.0) == shorter_timeout(2.0, 3.0) == 2.0
    )
    assert shorter_timeout(0.0, 0.0) == math.inf
