# SPDX-License-Identifier: Apache-2.0
"""Asks Linux for what the servo thread needs to keep its deadlines beside other work: sched(7), mlockall(2)."""

import ctypes
import os
from collections.abc import Callable
from dataclasses import dataclass

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
    """Of the calling thread alone. Raises OSError."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


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
    """SCHED_FIFO for the calling thread and locked memory for its process, as far as Linux grants them.

    The thread must sleep wherever it waits: one that spins would starve a core.

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
