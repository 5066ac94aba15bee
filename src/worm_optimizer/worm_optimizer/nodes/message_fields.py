# SPDX-License-Identifier: Apache-2.0
"""Dataclasses from messages whose fields have the same names."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeVar

T = TypeVar("T")


def value_of(kind: type[T], *messages: Any, **known: Any) -> T:
    """Return a dataclass whose fields are read from messages by name.

    Args:
        kind: the dataclass.
        messages: messages to read from. Each field is read from the first message that contains it.
        known: values of the fields that are not read from messages.
    """
    names = {row.name for row in dataclasses.fields(kind)} - known.keys()  # type: ignore[arg-type]
    taken = {n: getattr(m, n) for m in reversed(messages) for n in names if hasattr(m, n)}
    return kind(**taken, **known)
