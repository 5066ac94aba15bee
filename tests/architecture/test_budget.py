# SPDX-License-Identifier: Apache-2.0
"""Size of the workspace. Whoever adds a feature names the room that it replaces, or lowers another row."""

import ast
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LAYOUT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def docstring_lines(file: Path) -> Iterator[int]:
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if ast.get_docstring(node, clean=False) is not None else None
            if first is not None and first.end_lineno is not None:
                yield from range(first.lineno, first.end_lineno + 1)


def code_lines(file: Path) -> int:
    """Return the number of lines with code: without docstrings, comments and blank lines."""
    with file.open("rb") as content:
        tokens = [t for t in tokenize.tokenize(content.readline) if t.type not in LAYOUT]
    lines = {line for t in tokens for line in range(t.start[0], t.end[0] + 1)}
    return len(lines - set(docstring_lines(file)))


def lines(file: Path) -> int:
    return len(file.read_text().splitlines())


def words(file: Path) -> int:
    return len(file.read_text().split())


# what is counted, files, function, most
BUDGET = (
    ("lines of code in src", "src/**/*.py", code_lines, 38_000),
    ("all lines in src", "src/**/*.py", lines, 56_500),
    ("modules in src", "src/**/*.py", lambda _: 1, 380),
    ("lines in tests", "tests/**/*.py", lines, 31_000),
    ("words in docs", "docs/*.md", words, 27_000),
    ("words in README.md", "README.md", words, 1_100),
    ("words in CHANGELOG.md", "CHANGELOG.md", words, 800),
)


@pytest.mark.parametrize(("what", "files", "size", "most"), BUDGET, ids=[row[0] for row in BUDGET])
def test_the_workspace_stays_within_its_budget(what, files, size, most):
    found = sum(size(file) for file in ROOT.glob(files))
    print(f"{what}: {found} of {most}")
    assert found <= most


def test_docstrings_comments_and_blank_lines_are_no_code(tmp_path: Path):
    file = tmp_path / "some.py"
    file.write_text(
        '"""Two\nlines."""\n\n# why\nVALUE = """a\nb"""\n\ndef f():\n    "Say."\n    return 1\n'
    )
    assert code_lines(file) == 4
