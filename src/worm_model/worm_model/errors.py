# SPDX-License-Identifier: Apache-2.0
"""The one error that a command turns into exit status 2."""

from __future__ import annotations


class InputError(ValueError):
    """What somebody gave cannot be used; the message is one line that says what, where and what to do."""
