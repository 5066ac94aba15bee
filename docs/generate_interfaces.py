# SPDX-License-Identifier: Apache-2.0
"""Generator of the tables in interfaces.md and twin.md, and of the constants in TwinEvent.msg.

The messages' definitions, the optimizer's settings and the twin's causes are the sources. `./worm docs` runs it; a test
fails if a file is out of date. Text outside of the marks is written manually.
"""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

from worm_model.twin.cause_table import EVENT_CODES
from worm_optimizer.search.search_settings import SETTINGS, SettingRow

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "interfaces.md"
TWIN_PAGE = ROOT / "docs" / "twin.md"
TWIN_EVENT = ROOT / "src" / "worm_msgs" / "msg" / "TwinEvent.msg"


def generated(page: str) -> str:
    """Return interfaces.md with its marked parts up to date."""
    page = _replaced(page, "messages", _messages())
    return _replaced(page, "settings", _settings())


def generated_twin_page(page: str) -> str:
    """Return twin.md with its table of causes up to date."""
    rows = ["| Code | Meaning | Detected from |", "| --- | --- | --- |"]
    rows += [f"| `{row.code}` | {row.meaning} | {row.evidence} |" for row in EVENT_CODES]
    return _replaced(page, "causes", "\n".join(rows))


def generated_message(definition: str) -> str:
    """Return TwinEvent.msg with its constants up to date."""
    width = max(2 * len(row.code) for row in EVENT_CODES) + len('string =""')
    lines = [f"{_constant(row.code):<{width}}  # {row.meaning}\n" for row in EVENT_CODES]
    return re.sub(r"(?m)(^string [A-Z_]+=.*\n)+", lambda _: "".join(lines), definition, count=1)


def _constant(code: str) -> str:
    return f'string {code.upper()}="{code}"'


def _replaced(page: str, name: str, text: str) -> str:
    """Return a page with another text between the marks of a name."""
    begin, end = f"<!-- generated: {name} -->", f"<!-- end of {name} -->"
    return re.sub(f"(?s){begin}.*?{end}", lambda _: f"{begin}\n\n{text}\n\n{end}", page, count=1)


def _messages() -> str:
    """Return a table of all definitions, with the first sentence of their comments."""
    rows = ["| Definition | Meaning |", "| --- | --- |"]
    for kind in ("msg", "srv", "action"):
        for path in sorted((ROOT / "src" / "worm_msgs" / kind).iterdir()):
            comment = " ".join(re.findall(r"(?m)^# ?(.*)$", path.read_text(encoding="utf-8")))
            first = comment.split(". ")[0].rstrip(".")
            rows.append(f"| [{path.name}](../src/worm_msgs/{kind}/{path.name}) | {first} |")
    return "\n".join(rows)


def _settings() -> str:
    rows = ["| Option | Node parameter | Default |", "| --- | --- | --- |"]
    rows += [f"| `--{row.option}` | `{row.name}` | {_default(row)} |" for row in SETTINGS]
    return "\n".join(rows)


def _default(row: SettingRow) -> str:
    if isinstance(row.default, float):
        return "NaN" if math.isnan(row.default) else f"{row.default:g}"
    return str(row.default) or "empty"


def main() -> int:
    """Write the message's definition and the pages."""
    for path, update in (
        (TWIN_EVENT, generated_message),
        (TWIN_PAGE, generated_twin_page),
        (PAGE, generated),
    ):
        path.write_text(update(path.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
