# SPDX-License-Identifier: Apache-2.0
"""Tables for a terminal."""

import re
from collections.abc import Mapping, Sequence

_NUMBER = re.compile(r"[-+−]?(\d|nan|inf|none$)")


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of equal length as aligned text; the first row contains the column heads.

    A column is aligned to the right if each cell below its head begins with a number, is "none" or is empty. Any other
    column is aligned to the left.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    numbers = [
        all(not cell or _NUMBER.match(cell) for cell in column)
        for column in zip(*rows[1:], strict=True)
    ] or [False] * len(widths)
    return "\n".join(
        "  ".join(
            cell.rjust(width) if number else cell.ljust(width)
            for cell, width, number in zip(row, widths, numbers, strict=True)
        ).rstrip()
        for row in rows
    )


def labelled(values: Mapping[str, object]) -> str:
    """Return a line for each label and its value. The values begin in the same column."""
    width = max(map(len, values), default=0)
    return "\n".join(f"{label:<{width}}  {value}" for label, value in values.items())
