# SPDX-License-Identifier: Apache-2.0
"""Stamps of messages as numbers. This module imports no messages, which would lengthen the start of `operate`."""

from __future__ import annotations

from typing import Any

from worm_model.twin.data.records import NANOSECONDS


def nanoseconds(stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    total: int = stamp.sec * NANOSECONDS + stamp.nanosec
    return total
