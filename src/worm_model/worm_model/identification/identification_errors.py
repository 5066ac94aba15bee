# SPDX-License-Identifier: Apache-2.0
"""Exception of the identification."""

from __future__ import annotations

from worm_model.errors import InputError


class IdentificationError(InputError):
    """Recordings or bench tests that cannot be used; one line with the problem and the remedy."""
