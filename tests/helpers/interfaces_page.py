# SPDX-License-Identifier: Apache-2.0
"""The tables of docs/interfaces.md as data."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")


def rows_of(heading: str) -> dict[str, list[str]]:
    """Return the cells of the rows of one of the page's tables, by name; a row may have several names."""
    part = re.search(rf"^## {heading}$.*?(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert part
    rows = {}
    for line in re.findall(r"^\| `.*\|$", part[0], re.MULTILINE):
        first, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        rows |= dict.fromkeys(re.findall(r"`([^`]+)`", first), cells)
    return rows
