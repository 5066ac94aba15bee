# SPDX-License-Identifier: Apache-2.0
"""Generator of the JSON Schemas of the settings files, with which an editor completes and checks them.

The dataclasses that validate the files are the source. `./worm docs` runs it; a test fails if a schema is out of date.
"""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

from worm_driver.tracking.camera_model import CameraInfoFile
from worm_driver.tracking.tracker_setup import TrackerSetup
from worm_driver.virtual_robot.virtual_settings import RobotSettings
from worm_msgs.driver_file import DriverFile
from worm_msgs.robot_parameters import ParameterFileContent
from worm_msgs.settings_file import json_schema
from worm_optimizer.operation.system import SystemFile
from worm_optimizer.study.study_file import StudyFile

ROOT = Path(__file__).resolve().parents[1]
_DRIVER = ROOT / "src/worm_driver"
_WITHIN = _DRIVER / "worm_driver/config"
_OF_ROS = {  # parameters that every node accepts
    "use_sim_time": {"type": "boolean"},
    "start_type_description_service": {"type": "boolean"},
    "qos_overrides": {"type": "object"},
}


def parameter_file_schema(node: str, kind: type[Any]) -> dict[str, Any]:
    """Return the JSON Schema of ROS parameter files with a node, whose parameters are the dataclass ``kind``.

    A name such as limits.max_stroke_m is a key within a mapping. ROS also reads names with dots; the schema allows
    them, but does not check them.
    """
    flat = json_schema(kind)
    parameters = _mapping(dict(_OF_ROS), patternProperties={r"\.": {}})
    for row in dataclasses.fields(kind):
        *groups, name = row.metadata["alias"].split(".")
        place = parameters["properties"]
        for group in groups:
            place = place.setdefault(group, _mapping({}))["properties"]
        place[name] = flat["properties"][row.metadata["alias"]] | {
            "title": name,
            "description": row.metadata["meaning"],
        }
    content = {"ros__parameters": parameters}
    return {
        "$schema": flat["$schema"],
        "description": flat["description"],
        "type": "object",
        "patternProperties": {f"(^|/){node}$": {"type": "object", "properties": content}},
    }


def _mapping(properties: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": False, "properties": properties, **more}


#: Schema of each kind of file, by its path.
SCHEMAS: dict[Path, dict[str, Any]] = {
    _DRIVER / "config/driver.schema.json": parameter_file_schema("driver", DriverFile),
    _WITHIN / "camera_info.schema.json": json_schema(CameraInfoFile),
    _WITHIN / "tracker.schema.json": json_schema(TrackerSetup),
    _WITHIN / "virtual_robot.schema.json": json_schema(RobotSettings),
    ROOT / "src/worm_model/config/parameters.schema.json": json_schema(ParameterFileContent),
    ROOT / "src/worm_optimizer/config/study.schema.json": json_schema(StudyFile),
    ROOT / "src/worm_optimizer/config/system.schema.json": json_schema(SystemFile),
}


def generated(schema: dict[str, Any]) -> str:
    """Return the text of a schema file."""
    return json.dumps(schema, indent=2) + "\n"


def main() -> int:
    """Write the schemas."""
    for path, schema in SCHEMAS.items():
        path.write_text(generated(schema), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
