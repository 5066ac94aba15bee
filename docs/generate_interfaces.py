# SPDX-License-Identifier: Apache-2.0
"""Writes the generated parts of interfaces.md: messages from their definitions, the optimizer's settings from its rows.

Run by `./worm docs`; a test says when the page is out of date. What stands outside of the marks is written by hand.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from worm_optimizer.search.search_settings import SETTINGS, SettingRow

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "interfaces.md"
KINDS = {"msg": "message", "srv": "service", "action": "action"}
PARTS = {
    "msg": ("",),
    "srv": ("", "→ "),
    "action": ("", "→ ", "feedback "),
}  # between the lines ---
DECLARATION = re.compile(
    r"^(?P<type>\S+)\s+(?P<name>\w+)(?:\s*=\s*(?P<value>\S+)|\s+(?P<default>[^\s#=]+))?\s*(?:#\s*(?P<comment>.*))?$"
)


def generated(page: str) -> str:
    """The page with its marked parts made anew."""
    for name, text in (("messages", "\n\n".join(_messages())), ("settings", _settings())):
        begin, end = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
        page = re.sub(
            f"(?s){begin}.*?{end}", lambda _, t=f"{begin}\n\n{text}\n\n{end}": t, page, count=1
        )
    return page


def _messages() -> Iterator[str]:
    for kind, what in KINDS.items():
        for path in sorted((ROOT / "src" / "worm_msgs" / kind).iterdir()):
            yield f"### worm_msgs/{path.stem} ({what})\n\n{_definition(path, PARTS[kind])}"


def _definition(path: Path, prefixes: tuple[str, ...]) -> str:
    """What the definition says of itself, and a row for each field and constant."""
    remarks: list[str] = []
    rows = ["| Field | Type | Unit, meaning |", "| --- | --- | --- |"]
    parts = path.read_text(encoding="utf-8").split("\n---\n")
    for prefix, part in zip(prefixes, parts, strict=True):
        for line in filter(None, map(str.strip, part.splitlines())):
            if line.startswith("#"):
                remarks.append(line.lstrip("# "))
                continue
            found = DECLARATION.match(line)
            if found is None:
                raise ValueError(f"{path}: cannot be read: {line}")
            value = f" = {found['value']}" if found["value"] else ""
            value += f", default {found['default']}" if found["default"] else ""
            meaning = _plain(found["comment"] or "")
            rows.append(f"| {prefix}`{found['name']}`{value} | {found['type']} | {meaning} |")
    return _plain(" ".join(remarks)) + "\n\n" + "\n".join(rows)


def _plain(text: str) -> str:
    """Text without a meaning for Markdown."""
    return re.sub(r"([*|])", r"\\\1", text)


def _settings() -> str:
    rows = ["| Option | Node parameter | Default | Meaning |", "| --- | --- | --- | --- |"]
    rows += [
        f"| {f'`--{row.option}`' if row.option else ''} | `{row.parameter}` | {_default(row)} | {row.meaning} |"
        for row in SETTINGS
    ]
    return "\n".join(rows)


def _default(row: SettingRow) -> str:
    if isinstance(row.default, float):
        return "NaN" if math.isnan(row.default) else f"{row.default:g}"
    return str(row.default) or "empty"


def main() -> int:
    """Writes the page."""
    PAGE.write_text(generated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
