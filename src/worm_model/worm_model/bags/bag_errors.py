# SPDX-License-Identifier: Apache-2.0
"""The exceptions of everything that has to do with bags."""

from __future__ import annotations

from worm_model.errors import InputError


class BagError(InputError):
    """A bag cannot be read or written; the message is one line that says what is wrong and what to do."""


class ExistsError(BagError):
    """What should be written exists already; nothing is overwritten."""


class DefinitionError(BagError):
    """A message definition is missing, cannot be read, or is not that of a message."""


class UnwritableError(OSError):
    """The system does not let a bag be written where it should be; the message is one line."""
