# SPDX-License-Identifier: Apache-2.0
"""Asks Linux for what the servo thread needs to keep its deadlines beside other work: sched(7), mlockall(2)."""

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
class Urgency:
    """What a thread has got, in words.

    Attributes:
        granted: whether it has all that was asked for.
        words: what it has, or what is missing and what to do.
    """

    granted: bool
    words: str


NOT_ASKED = Urgency(granted=True, words="not asked for")
VIRTUAL = Urgency(granted=True, words="not needed: the virtual robot's time waits")


def _set_priority(priority: int) -> None:
    """Of the calling thread; half of it for the others, which share its interpreter. Raises OSError.

    A thread of normal priority that has the interpreter and waits for a processor keeps the first one waiting, too.
    """
    _schedule(os.SCHED_FIFO, priority, max(priority // 2, 1))


def return_to_normal() -> None:
    """Gives the priority of the process's threads back."""
    with contextlib.suppress(OSError):
        _schedule(os.SCHED_OTHER, 0, 0)


def _schedule(policy: int, own: int, others: int) -> None:
    """A policy for the process's threads, with the priorities of the calling one and of the others. Raises OSError."""
    caller = threading.get_native_id()
    for thread in [int(entry.name) for entry in Path("/proc/self/task").iterdir()]:
        with contextlib.suppress(ProcessLookupError):  # it has ended meanwhile
            os.sched_setscheduler(
                thread, policy, os.sched_param(own if thread == caller else others)
            )


def _lock_memory() -> None:
    """Of the process, each page from its first use on: none is fetched from a disk in a cycle. Raises OSError."""
    if ctypes.CDLL(None, use_errno=True).mlockall(_CURRENT | _FUTURE | _ON_FAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def ask_for_urgency(
    priority: int,
    set_priority: Callable[[int], None] = _set_priority,
    lock_memory: Callable[[], None] = _lock_memory,
) -> Urgency:
    """SCHED_FIFO for the calling thread, half of it and locked memory for its process, as far as Linux grants them.

    The threads must sleep wherever they wait: one that spins would starve a core.

    Args:
        priority: 1 to 99; 0 asks for nothing.
        set_priority: raises OSError if it may not.
        lock_memory: likewise.
    """
    if priority == 0:
        return NOT_ASKED
    refused = []
    for what, act in (
        (f"SCHED_FIFO {priority}", lambda: set_priority(priority)),
        ("locked memory", lock_memory),
    ):
        try:
            act()
        except OSError as error:
            refused.append(f"no {what} ({error.strerror})")
    if refused:
        return Urgency(granted=False, words=f"{', '.join(refused)}: {_REMEDY}")
    return Urgency(granted=True, words=f"SCHED_FIFO {priority}, memory locked")
