# SPDX-License-Identifier: Apache-2.0
"""The layouts, compared with the interfaces that they show."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import yaml

ROOT = Path(__file__).resolve().parents[4]


def fields(name: str) -> set[str]:
    lines = (ROOT / "src/worm_msgs/msg" / f"{name}.msg").read_text().splitlines()
    return {line.split()[1] for line in lines if re.match(r"[a-z]\w*(/\w+)? +\w+ ", line + " ")}


TYPES = {
    "/worm/tracker": "Tracker",
    "/worm/power": "Power",
    "/worm/twin/state": "TwinState",
    "/worm/twin/residuals": "TwinResiduals",
    "/worm/twin/events": "TwinEvent",
}
MARGINS = {"rear_margin", "front_margin", "last_rear_margin", "last_front_margin"}


def shown_fields(paths: list[str], separator: str) -> set[str]:
    """Return the fields of the paths, which exist in the messages of their topics."""
    assert len(paths) > 10
    split = [path.rpartition(separator) for path in paths]
    for topic, _, field in split:
        assert field in fields(TYPES.get(topic, "BodyLength")), (topic, field)
    return {field for _, _, field in split}


def test_the_foxglove_layout_shows_topics_and_fields_that_exist():
    layout = json.loads((ROOT / "src/worm_model/foxglove/worm.json").read_text())
    paths = [
        path["value"] for panel in layout["configById"].values() for path in panel.get("paths", [])
    ]
    assert shown_fields(paths, ".") >= MARGINS
    raw = {panel.get("topicPath") for panel in layout["configById"].values()}
    assert "/worm/twin/events" in raw

    def panels(node):
        return [node] if isinstance(node, str) else panels(node["first"]) + panels(node["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])


def test_the_plotjuggler_layout_shows_topics_and_fields_that_exist():
    layout = ElementTree.parse(ROOT / "src/worm_model/plotjuggler/worm.xml")
    names = [curve.get("name") for curve in layout.iter("curve")]
    assert shown_fields(names, "/") >= MARGINS | {"probability"}
    subscribed = layout.find("Plugins/plugin/selected_topics").get("value").split(";")
    assert set(subscribed) == {name.rpartition("/")[0] for name in names}
    for splitter in layout.iter("DockSplitter"):
        count = len(splitter.findall("DockArea") + splitter.findall("DockSplitter"))
        assert int(splitter.get("count")) == len(splitter.get("sizes").split(";")) == count


def test_the_rviz_configuration_shows_the_twins_markers():
    content = yaml.safe_load((ROOT / "src/worm_model/rviz/worm.rviz").read_text())
    manager = content["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "pipe"
    topics = [d["Topic"]["Value"] for d in manager["Displays"] if "Topic" in d]
    assert topics == ["/worm/twin/markers"]
