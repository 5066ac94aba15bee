# SPDX-License-Identifier: Apache-2.0
"""The JSON Schemas of the settings files are up to date, and the files of this repository name them."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
GENERATOR = SimpleNamespace(**runpy.run_path(str(ROOT / "docs/generate_schemas.py")))
MODELINE = "# yaml-language-server: $schema="
FILES = [
    path
    for folder in ("src", "examples", "tests/helpers")
    for path in sorted((ROOT / folder).rglob("*.yaml"))
    if path.read_text(encoding="utf-8").startswith(MODELINE)
]


@pytest.mark.parametrize("path", GENERATOR.SCHEMAS, ids=lambda path: path.name)
def test_a_schema_is_up_to_date(path):
    assert path.read_text(encoding="utf-8") == GENERATOR.generated(GENERATOR.SCHEMAS[path])


def test_each_schema_is_named_by_a_file_of_its_kind():
    lines = {path: path.read_text(encoding="utf-8").splitlines()[0] for path in FILES}
    named = {(path.parent / line.removeprefix(MODELINE)).resolve() for path, line in lines.items()}
    assert named == set(GENERATOR.SCHEMAS)


def test_the_schema_of_the_driver_has_the_keys_of_its_file():
    """The file in this repository contains every parameter, in groups."""
    folder = ROOT / "src/worm_driver/config"
    content = yaml.safe_load((folder / "driver.yaml").read_text(encoding="utf-8"))
    schema = GENERATOR.SCHEMAS[folder / "driver.schema.json"]
    (node,) = schema["patternProperties"].values()

    def keys(part: dict, inner: str) -> set[tuple[str, ...]]:
        found = set()
        for name, value in part.items():
            below = value.get(inner) if inner and isinstance(value, dict) else value
            deeper = keys(below, inner) if isinstance(below, dict) else {()}
            found |= {(name, *rest) for rest in deeper}
        return found

    own = keys(content["/**/driver"]["ros__parameters"], "")
    of_ros = {("use_sim_time",), ("start_type_description_service",), ("qos_overrides",)}
    assert keys(node["properties"]["ros__parameters"]["properties"], "properties") == own | of_ros
