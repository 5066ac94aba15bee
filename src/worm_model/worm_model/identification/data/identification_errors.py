# SPDX-License-Identifier: Apache-2.0
"""Exception of the identification."""

from __future__ import annotations

from worm_model.errors import InputError


class IdentificationError(InputError):
    """Error for recordings or bench tests that cannot be used; the message is one line with problem and remedy."""
