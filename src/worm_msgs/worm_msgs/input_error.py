# SPDX-License-Identifier: Apache-2.0
"""Error for bad input."""


class InputError(ValueError):
    """Input that cannot be used. The message is one line that says what is wrong, where, and what to do.

    Commands report it with exit status 2.
    """
