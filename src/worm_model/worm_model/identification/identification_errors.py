# SPDX-License-Identifier: Apache-2.0
"""The exception of the identification."""

from __future__ import annotations

from worm_model.errors import InputError


class IdentificationError(InputError):
    """Recordings or bench tests from which nothing can be identified; one line that says what and what to do."""
