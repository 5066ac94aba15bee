# SPDX-License-Identifier: Apache-2.0
"""The servo thread's requests to Linux, with a fake Linux."""

import errno
import os
import threading

import pytest

from worm_driver.control.real_time import (
    NOT_REQUESTED,
    Scheduling,
    request_scheduling,
    return_to_normal,
)


def granted(_: int) -> None:
    return None


def rejected(*_: int) -> None:
    raise PermissionError(errno.EPERM, "Operation not permitted")


def test_the_calling_thread_gets_the_requested_scheduling():
    requested: list[int] = []
    scheduling = request_scheduling(40, requested.append, lambda: requested.append(-1))
    assert requested == [40, -1]
    assert scheduling == Scheduling(granted=True, description="SCHED_FIFO 40, memory locked")


def test_a_rejected_request_is_named_with_a_remedy_and_the_rest_is_kept():
    scheduling = request_scheduling(40, rejected, lambda: None)
    assert not scheduling.granted
    assert scheduling.description.startswith("no SCHED_FIFO 40 (Operation not permitted): grant it")
    assert "locked memory" not in scheduling.description
    both = request_scheduling(40, rejected, rejected)
    assert "no SCHED_FIFO 40" in both.description
    assert "no locked memory" in both.description
    memory = request_scheduling(7, granted, rejected)
    assert memory.description.startswith("no locked memory")


def test_it_may_be_turned_off():
    assert request_scheduling(0, rejected, rejected) is NOT_REQUESTED


def test_the_main_thread_gets_half_the_priority_until_the_end():
    def priorities() -> tuple[int, int]:
        main = threading.main_thread().native_id
        return os.sched_getparam(0).sched_priority, os.sched_getparam(main).sched_priority

    def servo_thread() -> None:
        urgencies.append(request_scheduling(10, lock_memory=lambda: None))
        found.append(priorities())
        return_to_normal()
        found.append(priorities())

    found: list[tuple[int, int]] = []
    urgencies: list[Scheduling] = []
    thread = threading.Thread(target=servo_thread)
    thread.start()
    thread.join()
    if not urgencies[0].granted:
        pytest.skip(urgencies[0].description)
    assert found == [(10, 5), (0, 0)]
