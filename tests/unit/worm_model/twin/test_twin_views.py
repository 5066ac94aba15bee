# SPDX-License-Identifier: Apache-2.0
"""The terminal view, and the layouts compared with the interfaces that they show."""

import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from worm_model.parameters import PAPER
from worm_model.run import Activity
from worm_model.twin.data.records import Health
from worm_model.twin.watch_view import CLEAR, View, render

ROOT = Path(__file__).resolve().parents[4]
ANSI = re.compile(r"\033\[\d+m")
VIEW = View(
    activity=Activity.RUNNING,
    gait="70.0 mm at 0.200 Hz forward",
    cycle=2,
    cycles=5,
    health=Health.SUSPECT,
    message="the robot missed a groove",
    twin=(0.1, 0.39),
    robot=(0.0827, 0.3727),
    rear_anchor=0.1,
    power=(3.0, 6.0),
)


def text(view: View, width: int = 80) -> list[str]:
    return [ANSI.sub("", line) for line in render(view, PAPER.pitch, width)]


@pytest.mark.parametrize("width", [40, 47, 60, 80, 120])
@pytest.mark.parametrize("view", [View(), VIEW])
def test_no_line_is_wider_than_the_terminal(view, width):
    lines = text(view, width)
    assert max(map(len, lines)) <= width
    assert CLEAR not in "".join(lines)
    assert "nan" not in "".join(lines)


def test_missing_data_is_shown_as_missing():
    assert "no driver" in text(View())[0]
    assert "(no twin)" in text(View())
    assert any("grooves: -" in line for line in text(View()))
    unseen = text(replace(VIEW, robot=(float("nan"), float("nan"))))
    assert "#" not in unseen[5]


def test_what_is_stale_is_not_shown_as_the_present():
    fresh = VIEW.aged({"twin": 0.2, "tracker": 0.9, "power": 0.1, "driver": 0.0})
    assert text(fresh) == text(VIEW)
    old = text(VIEW.aged({"twin": 3.2, "tracker": 4.0, "power": 0.1, "driver": 70.0}))
    assert old[1].split() == ["twin", "unknown"]
    assert old[2] == "driver silent for 70 s, twin silent for 3 s, tracker silent for 4 s"
    assert "(no twin)" in old
    assert "#" not in "".join(old)
    assert next(line for line in old if line[:2] == "x1").split() == ["x1", "mm", "-", "-", "-"]
    alone = text(VIEW.aged({"twin": 3.2}))
    assert next(line for line in alone if line[:5] == "power").split()[2:] == ["-", "6.00", "-"]
    dark = VIEW.aged({"power": 1.5})
    assert ["measured", "-", "W"] in [line.split() for line in text(dark)]


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
