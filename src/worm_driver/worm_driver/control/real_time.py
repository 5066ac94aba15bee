# SPDX-License-Identifier: Apache-2.0
"""Real-time scheduling and locked memory, so that the servo thread meets its deadlines: sched(7), mlockall(2)."""

import contextlib
import ctypes
import os
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4  # MCL_…, asm-generic/mman.h
_REMEDY = (
    "grant it (systemd: LimitRTPRIO, LimitMEMLOCK=infinity; a login: rtprio and memlock in "
    "/etc/security/limits.d), or set real_time_priority to 0"
)


@dataclass(frozen=True)
class Scheduling:
    """Real-time scheduling that a thread has.

    Attributes:
        granted: True if Linux granted all that was requested.
        description: description of the scheduling, or what is missing and what to do.
    """

    granted: bool
    description: str


NOT_REQUESTED = Scheduling(granted=True, description="not requested")
VIRTUAL = Scheduling(granted=True, description="not needed: virtual time waits for threads")


def _set_priority(priority: int) -> None:
    """Set SCHED_FIFO with a priority for the calling thread, and with half of it for the other threads of the process.

    A thread of normal priority that holds the interpreter and waits for a processor would block the calling thread.
    """
    _schedule(os.SCHED_FIFO, priority, max(priority // 2, 1))


def return_to_normal() -> None:
    """Return all threads of the process to normal scheduling."""
    with contextlib.suppress(OSError):
        _schedule(os.SCHED_OTHER, 0, 0)


def _schedule(policy: int, own: int, others: int) -> None:
    """Set the scheduling policy of the process's threads, with priorities for the calling thread and for the others."""
    caller = threading.get_native_id()
    for thread in [int(entry.name) for entry in Path("/proc/self/task").iterdir()]:
        with contextlib.suppress(ProcessLookupError):  # the thread has ended meanwhile
            os.sched_setscheduler(
                thread, policy, os.sched_param(own if thread == caller else others)
            )


def _lock_memory() -> None:
    """Lock each page of the process in memory from its first use, so that no cycle waits for a disk."""
    if ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE | _ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def request_scheduling(
    priority: int,
    set_priority: Callable[[int], None] = _set_priority,
    lock_memory: Callable[[], None] = _lock_memory,
) -> Scheduling:
    """Request SCHED_FIFO for the calling thread, half the priority for the other threads, and locked memory.

    All threads must sleep while they wait, because a spinning real-time thread would block a core.

    Args:
        priority: priority, 1 to 99; 0 requests nothing.
        set_priority, lock_memory: functions that raise OSError if Linux does not permit the change.

    Returns:
        Granted scheduling. If Linux rejects a part of the request, the description names this part and the remedy.
    """
    if priority == 0:
        return NOT_REQUESTED
    missing = []
    for what, act in (
        (f"SCHED_FIFO {priority}", lambda: set_priority(priority)),
        ("locked memory", lock_memory),
    ):
        try:
            act()
        except OSError as error:
            missing.append(f"no {what} ({error.strerror})")
    if missing:
        return Scheduling(granted=False, description=f"{', '.join(missing)}: {_REMEDY}")
    return Scheduling(granted=True, description=f"SCHED_FIFO {priority}, memory locked")
