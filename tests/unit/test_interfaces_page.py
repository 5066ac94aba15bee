# SPDX-License-Identifier: Apache-2.0
"""The generated parts of docs/interfaces.md are up to date, and its figure agrees with its tables.

tests/integration/test_graph.py compares the tables of topics, services and actions with the running nodes.
"""

import re
import runpy
from types import SimpleNamespace

from interfaces_page import PAGE, ROOT, rows_of

from worm_driver.nodes import driver_parameters
from worm_driver.tracking import tracker_setup
from worm_model.twin import twin_settings
from worm_model.twin.core.estimator import PERIOD_NS
from worm_optimizer.search import search_settings

GENERATOR = SimpleNamespace(**runpy.run_path(str(ROOT / "docs/generate_interfaces.py")))


def test_the_generated_parts_are_up_to_date():
    assert GENERATOR.generated(PAGE) == PAGE, "run ./worm docs"
    twin_page = GENERATOR.TWIN_PAGE.read_text(encoding="utf-8")
    assert GENERATOR.generated_twin_page(twin_page) == twin_page, "run ./worm docs"
    message = GENERATOR.TWIN_EVENT.read_text(encoding="utf-8")
    assert GENERATOR.generated_message(message) == message, "run ./worm docs"
    assert "| [RunGait.action](../src/worm_msgs/action/RunGait.action) | Run a gait" in PAGE
    assert "| `--margin` | `margin_m` | NaN |" in PAGE


def test_a_part_that_is_out_of_date_is_generated_again():
    stale = PAGE.replace("RunGait.action", "RunStride.action")
    assert stale != PAGE
    assert GENERATOR.generated(stale) == PAGE


def test_the_twins_greatest_rate_is_the_pages():
    rate = 1e9 / PERIOD_NS
    assert rows_of("Topics")["twin/state"][2] == f"with the length, at most {rate:.0f} Hz"


def test_the_drawing_has_the_names_and_types_of_the_tables():
    drawing = re.search(r"```mermaid\n(.*?)```", PAGE, re.DOTALL)
    assert drawing
    drawn = {
        (name, kind)
        for names, kind in re.findall(r"([\w/, ]+): (\w+)", drawing[1])
        for name in re.findall(r"[\w/]+", names.split("and ")[-1])
    }
    rows = rows_of("Topics") | rows_of("Services") | rows_of("Actions")
    known = {(name, cells[0].split("/")[-1]) for name, cells in rows.items()}
    assert drawn - known == set()
    private = {name for name, _ in known if name[0] in "~/" or name.startswith("driver/")}
    missing = {name for name, _ in known} - {name for name, _ in drawn} - private
    assert missing == {"inject_fault"}


def test_names_of_parameters_and_keys_are_lower_snake_case_with_the_unit_last():
    nodes = (driver_parameters, twin_settings, search_settings, tracker_setup)
    names = [row.name for node in nodes for row in node.rows()]
    assert len(names) > 50
    wrong = re.compile(r"[A-Z]|_m_s$|_rad_s$|[^a-z0-9_.]")
    assert [name for name in names if wrong.search(name)] == []
