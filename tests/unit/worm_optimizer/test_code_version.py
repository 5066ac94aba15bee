# SPDX-License-Identifier: Apache-2.0
"""The version of the code that a study's store states."""

import subprocess
import sys
from pathlib import Path

from worm_optimizer.code_version import sources

# Modules that a point imports, and on which no number depends.
NO_NUMBERS = {
    *("worm_model", "worm_model.margin", "worm_msgs", "worm_optimizer", "worm_optimizer.study"),
    *("worm_optimizer.optimizer_errors", "worm_optimizer.code_version"),
    *("worm_msgs.input_error", "worm_msgs.parameter_rows"),
    *("worm_msgs.settings_file", "worm_msgs.yaml_file"),
}
LISTING = """
import sys
import worm_optimizer.study.point
for name, module in list(sys.modules.items()):
    if name.startswith("worm_"):
        print(name, module.__file__)
"""


def test_the_sources_are_all_modules_on_which_the_numbers_of_a_point_depend():
    done = subprocess.run(
        [sys.executable, "-c", LISTING], capture_output=True, text=True, check=True
    )
    imported = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    known = {path.resolve() for path in sources()}
    missing = {name for name, file in imported.items() if Path(file).resolve() not in known}
    assert missing <= NO_NUMBERS
