# SPDX-License-Identifier: Apache-2.0
"""Error for bad input, and printable forms of texts."""


class InputError(ValueError):
    """Input that cannot be used. The message is one line that says what is wrong, where, and what to do.

    Commands report it with exit status 2.
    """


def printable(text: str) -> str:
    """Return the text of a path or an argument, in which each byte that is not valid UTF-8 is an escape sequence."""
    return text.encode(errors="backslashreplace").decode()
