# SPDX-License-Identifier: Apache-2.0
"""The one error that a command turns into exit status 2."""

from __future__ import annotations


class InputError(ValueError):
    """What somebody gave cannot be used; the message is one line that says what, where and what to do."""


def printable(text: str) -> str:
    """Return a text with an escape for each byte of a path or an argument that is not UTF-8."""
    return text.encode(errors="backslashreplace").decode()
