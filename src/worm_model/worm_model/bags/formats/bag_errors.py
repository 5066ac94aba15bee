# SPDX-License-Identifier: Apache-2.0
"""Exceptions of all operations on bags."""

from __future__ import annotations

from worm_model.errors import InputError

#: command that saves the readable messages of a bag, to be followed by its path
RECOVER = "./worm run worm_model recover"


class BagError(InputError):
    """Bag that cannot be read or written; the message is one line with the reason and the remedy."""


class ExistsError(BagError):
    """Output path that exists already; it is not overwritten."""


class NoRunError(BagError):
    """Bag that contains no run of the worm."""


class DefinitionError(BagError):
    """Message definition that is missing, cannot be read, or does not match a message."""


class UnwritableError(OSError):
    """Bag that cannot be written because of an error of the operating system; the message is one line."""
