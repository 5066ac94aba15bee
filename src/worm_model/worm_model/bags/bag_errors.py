# SPDX-License-Identifier: Apache-2.0
"""Exceptions of all operations on bags."""

from __future__ import annotations

from worm_model.errors import InputError


class BagError(InputError):
    """Bag that cannot be read or written; the message is one line with the reason and the remedy."""


class ExistsError(BagError):
    """Existing output; nothing is overwritten."""


class DefinitionError(BagError):
    """Message definition that is missing, cannot be read, or does not match a message."""


class UnwritableError(OSError):
    """Location where the operating system does not permit to write a bag; the message is one line."""
