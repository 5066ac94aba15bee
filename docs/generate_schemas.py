# SPDX-License-Identifier: Apache-2.0
"""Generator of the JSON Schemas of the settings files, with which an editor completes and checks them.

The dataclasses that validate the files are the source. `./worm docs` runs it; a test fails if a schema is out of date.
"""

import json
import sys
from pathlib import Path
from typing import Any

from worm_driver.tracking.tracker_setup import SetupFile
from worm_driver.virtual_robot.camera_images import CameraSettings
from worm_driver.virtual_robot.virtual_settings import RobotSettings
from worm_msgs.robot_parameters import ParameterFileContent
from worm_msgs.settings_file import json_schema
from worm_optimizer.operation.system import SystemFile
from worm_optimizer.study.study_file import StudyFile

ROOT = Path(__file__).resolve().parents[1]
_DRIVER = ROOT / "src/worm_driver/worm_driver/config"
#: Dataclass of each kind of file, by the path of its schema.
SETTINGS: dict[Path, type[Any]] = {
    _DRIVER / "tracker.schema.json": SetupFile,
    _DRIVER / "virtual_camera.schema.json": CameraSettings,
    _DRIVER / "virtual_robot.schema.json": RobotSettings,
    ROOT / "src/worm_model/config/parameters.schema.json": ParameterFileContent,
    ROOT / "src/worm_optimizer/config/study.schema.json": StudyFile,
    ROOT / "src/worm_optimizer/config/system.schema.json": SystemFile,
}


def generated(kind: type[Any]) -> str:
    """Return the text of a schema file."""
    return json.dumps(json_schema(kind), indent=2) + "\n"


def main() -> int:
    """Write the schemas."""
    for path, kind in SETTINGS.items():
        path.write_text(generated(kind), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
