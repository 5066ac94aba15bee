# SPDX-License-Identifier: Apache-2.0
"""Errors for bad input and printable forms of texts."""

from __future__ import annotations

from worm_msgs.input_error import InputError as InputError


class RecordingError(InputError):
    """The recording lacks data for a metric; the message names the missing data."""


def printable(text: str) -> str:
    """Return the text of a path or an argument, in which each byte that is not valid UTF-8 is an escape sequence."""
    return text.encode(errors="backslashreplace").decode()
