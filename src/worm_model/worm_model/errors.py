# SPDX-License-Identifier: Apache-2.0
"""Errors for bad input, and printable forms of texts."""

from __future__ import annotations

from worm_msgs.input_error import InputError as InputError
from worm_msgs.input_error import printable as printable


class RecordingError(InputError):
    """The recording lacks data for a metric; the message names the missing data."""


class IdentificationError(InputError):
    """The data do not suffice for an identification; the message names what is missing, and what to do."""
