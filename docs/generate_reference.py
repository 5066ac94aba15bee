# SPDX-License-Identifier: Apache-2.0
"""Writes the reference of the public modules, those of the table in api.md, as HTML. Run by `./worm docs`."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pdoc
import pdoc.doc
import pdoc.render
from numpy.typing import ArrayLike

PAGE = Path(__file__).with_name("api.md")
MODULE = re.compile(r"`(worm_\w+(?:\.\w+)+)`")
ARRAY = re.compile(
    r"numpy\.ndarray\[(?:tuple\[[^]]*\]|typing\.Any), numpy\.dtype\[numpy\.(\w+?)_?\]\]"
)
NOTE = "The public modules, listed in docs/api.md. All others are internals and may change at any time."


def public_modules(page: str) -> list[str]:
    """The modules that the rows of the page's table name, in their order."""
    rows = [line for line in page.splitlines() if line.startswith("| `worm_")]
    return [name for row in rows for name in MODULE.findall(row)]


def shortened(text: str) -> str:
    """A type with its arrays as they are written in the sources."""
    return ARRAY.sub(r"NDArray[\1]", text)


def _shortening(written: Callable[..., str]) -> Callable[..., str]:
    def write(annotation: Any, *more: Any, **named: Any) -> str:
        if annotation == ArrayLike:
            return "ArrayLike"
        return shortened(written(annotation, *more, **named))

    return write


def main(folder: Path) -> None:
    """Write the reference into a folder."""
    inspect.formatannotation = _shortening(inspect.formatannotation)
    pdoc.doc.formatannotation = _shortening(pdoc.doc.formatannotation)
    pdoc.render.configure(docformat="google", footer_text=NOTE)
    modules = public_modules(PAGE.read_text(encoding="utf-8"))
    pdoc.pdoc(*modules, output_directory=folder)
    for page in folder.rglob("*.html"):  # the values of aliases are written as they are
        page.write_text(shortened(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
