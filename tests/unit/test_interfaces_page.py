# SPDX-License-Identifier: Apache-2.0
"""docs/interfaces.md against worm_msgs and the code: nothing of either may be missing from the page."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")
DEFINITIONS = sorted(
    path for kind in ("msg", "srv", "action") for path in (ROOT / "src/worm_msgs" / kind).iterdir()
)
DECLARATION = re.compile(r"^[\w/\[\]]+\s+([A-Za-z_]\w*)\s*(=|$)")
CREATORS = {"create_publisher": 1, "create_subscription": 1, "create_service": 1, "ActionServer": 2}


def names_in(definition: Path) -> list[str]:
    """Fields and constants of a message definition."""
    lines = (
        line.split("#")[0].strip() for line in definition.read_text(encoding="utf-8").splitlines()
    )
    return [match[1] for line in lines if (match := DECLARATION.match(line))]


def section_of(name: str) -> str:
    """The part of the page under the heading of a message."""
    found = re.search(rf"^### worm_msgs/{name}\b.*?(?=^##|\Z)", PAGE, re.MULTILINE | re.DOTALL)
    return found[0] if found else ""


def graph_names() -> set[str]:
    """Topics, services and actions that the code makes, where it says their names outright."""
    names = set()
    for path in (ROOT / "src").glob("*/*/**/*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            called = call.func.attr if isinstance(call.func, ast.Attribute) else ""
            called = call.func.id if isinstance(call.func, ast.Name) else called
            place = CREATORS.get(called)
            if place is not None and len(call.args) > place:
                argument = call.args[place]
                if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                    names.add(argument.value)
    return names


@pytest.mark.parametrize("definition", DEFINITIONS, ids=lambda path: path.stem)
def test_every_field_and_constant_is_on_the_page(definition: Path):
    section = section_of(definition.stem)
    assert section, f"docs/interfaces.md has no section worm_msgs/{definition.stem}"
    names = names_in(definition)
    assert names
    assert [name for name in names if f"`{name}`" not in section] == []


@pytest.mark.parametrize("heading", re.findall(r"^### worm_msgs/(\w+)", PAGE, re.MULTILINE))
def test_every_section_has_its_definition(heading: str):
    assert heading in [path.stem for path in DEFINITIONS]


@pytest.mark.parametrize("definition", DEFINITIONS, ids=lambda path: path.stem)
def test_the_page_names_no_field_that_is_gone(definition: Path):
    rows = re.findall(r"^\| (.*?) \|", section_of(definition.stem), re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert named - set(names_in(definition)) == set()


def test_every_name_of_the_graph_is_on_the_page():
    names = graph_names()
    assert {"power", "gait_state", "stop", "run_gait", "twin/state"} <= names
    assert sorted(name for name in names if f"`{name}`" not in PAGE) == []
