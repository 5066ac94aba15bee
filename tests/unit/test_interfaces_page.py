# SPDX-License-Identifier: Apache-2.0
"""docs/interfaces.md against worm_msgs and the code: nothing of either may be missing from the page."""

import ast
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from worm_model.twin.twin_settings import DEFAULTS

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "interfaces.md").read_text(encoding="utf-8")
DEFINITIONS = sorted(
    path for kind in ("msg", "srv", "action") for path in (ROOT / "src/worm_msgs" / kind).iterdir()
)
DECLARATION = re.compile(r"^[\w/\[\]]+\s+([A-Za-z_]\w*)\s*(=|$)")
PUBLISHER, SERVICE = "create_publisher", "create_service"
ACTIONS = ("ActionServer", "_serve_action")
CREATORS = {  # place of the name among the arguments; the type stands before it
    PUBLISHER: 1,
    "create_subscription": 1,
    SERVICE: 1,
    "ActionServer": 2,
    "_serve_action": 1,
}


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


@dataclass(frozen=True)
class Made:
    """A topic, service or action that the code makes under a name that it says outright.

    ``node`` is the file's stem without ``_node``; ``depth`` and ``latched`` are None but for publishers.
    """

    node: str
    how: str
    name: str
    kind: str
    depth: int | None = None
    latched: bool | None = None


def called(call: ast.Call) -> str:
    """Name of the function or class that is called."""
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def constants_of(tree: ast.Module) -> dict[str, ast.expr]:
    """What a module's own names stand for."""
    found = {}
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found[node.targets[0].id] = node.value
    return found


def quality_of(argument: ast.expr, constants: dict[str, ast.expr]) -> tuple[int, bool]:
    """(depth, whether it is transient local) of a publisher's last argument."""
    while isinstance(argument, ast.Name):
        argument = constants[argument.id]
    if isinstance(argument, ast.Constant):
        return int(argument.value), False
    assert isinstance(argument, ast.Call)
    assert called(argument) == "QoSProfile"
    given = {word.arg: word.value for word in argument.keywords}
    text = {word: ast.unparse(value) for word, value in given.items()}
    assert text.get("reliability", "RELIABLE").endswith("RELIABLE")
    durability = text.get("durability", "VOLATILE").split(".")[-1]
    assert durability in ("VOLATILE", "TRANSIENT_LOCAL")
    depth = ast.literal_eval(given["depth"])
    return depth, durability == "TRANSIENT_LOCAL"


def made_by_code() -> list[Made]:
    """All that the code makes of the graph, where it says the names outright."""
    made = []
    for path in sorted((ROOT / "src").glob("*/*/**/*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        constants = constants_of(tree)
        for call in ast.walk(tree):
            if not isinstance(call, ast.Call) or called(call) not in CREATORS:
                continue
            how = called(call)
            place = CREATORS[how]
            name = call.args[place] if len(call.args) > place else None
            if not (isinstance(name, ast.Constant) and isinstance(name.value, str)):
                continue
            kind = ast.unparse(call.args[place - 1])
            quality = quality_of(call.args[-1], constants) if how == PUBLISHER else (None, None)
            node = path.stem.removesuffix("_node").replace("_", " ")
            made.append(Made(node, how, name.value, kind, *quality))
    return made


MADE = made_by_code()


def rows_of(heading: str) -> dict[str, list[str]]:
    """Cells of the rows of one of the page's tables by name; a row may have several names."""
    part = re.search(rf"^## {heading}$.*?(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL)
    assert part
    rows = {}
    for line in re.findall(r"^\| `.*\|$", part[0], re.MULTILINE):
        first, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        rows |= dict.fromkeys(re.findall(r"`([^`]+)`", first), cells)
    return rows


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
    names = {made.name for made in MADE}
    assert {"power", "gait_state", "stop", "run_gait", "scan_margin", "twin/state"} <= names
    assert sorted(name for name in names if f"`{name}`" not in PAGE) == []


@pytest.mark.parametrize(
    "made", [made for made in MADE if made.how == PUBLISHER], ids=lambda m: f"{m.node}-{m.name}"
)
def test_type_node_and_quality_of_service_of_a_topic_are_the_pages(made: Made):
    kind, source, _, quality = rows_of("Topics")[made.name]
    assert kind.split("/")[-1] == made.kind
    assert made.node in source or f"`{made.node}`" in source
    assert quality == f"reliable, {'transient local, ' if made.latched else ''}depth {made.depth}"


@pytest.mark.parametrize(
    "made",
    [made for made in MADE if made.how in (SERVICE, *ACTIONS)],
    ids=lambda m: f"{m.node}-{m.name}",
)
def test_type_of_a_service_or_action_is_the_pages(made: Made):
    rows = rows_of("Services") | rows_of("Actions")
    kind, owner = rows[made.name][:2]
    assert kind.split("/")[-1] == made.kind
    assert made.how in ACTIONS or made.node in owner.strip("`")


def test_the_page_has_no_topic_that_nothing_publishes():
    published = {made.name for made in MADE if made.how == PUBLISHER}
    assert sorted(set(rows_of("Topics")) - published) == []


def test_the_twins_greatest_rate_is_the_pages():
    rate = 1.0 / DEFAULTS.output_period_s
    assert rows_of("Topics")["twin/state"][2] == f"with the length, at most {rate:.0f} Hz"


def test_the_drawing_of_the_graph_has_the_codes_names_and_types():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    drawing = re.search(r"```mermaid\n(.*?)```", readme, re.DOTALL)
    assert drawing
    drawn = {
        (name, kind)
        for names, kind in re.findall(r"([\w/, ]+): (\w+)", drawing[1])
        for name in re.findall(r"[\w/]+", names.split("and ")[-1])
    }
    served = {(made.name, made.kind) for made in MADE if made.how != "create_subscription"}
    assert drawn - served == set()
    private = {name for name, _ in served if name[0] in "~/"}
    assert {name for name, _ in served} - {name for name, _ in drawn} - private == {"inject_fault"}
