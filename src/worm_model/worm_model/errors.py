# SPDX-License-Identifier: Apache-2.0
"""Error that commands turn into exit status 2."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used. The message is one line that says what is wrong, where, and what to do."""


def printable(text: str) -> str:
    """Return a text in which each byte of a path or argument that is not UTF-8 is replaced by an escape sequence."""
    return text.encode(errors="backslashreplace").decode()
