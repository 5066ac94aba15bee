# SPDX-License-Identifier: Apache-2.0
"""What --help of each executable imports: packages that load slowly make it slow."""

import subprocess
import sys

import pytest
from documented_commands import entry_points

LOADED = """
import contextlib, importlib, sys
sys.argv = ["command", "--help"]
with contextlib.suppress(SystemExit):
    importlib.import_module(MODULE).FUNCTION()
print(*sys.modules)
"""


SLOW = {
    "cv2",
    "distributed",
    "matplotlib",
    "numba",
    "pydantic",
    "pymoo",
    "rosbags.rosbag2",
    "scipy",
    "xarray",
}
LIGHTEST = {"bags", "evaluate_gait", "simulate"}  # these also begin without NumPy and rosbags
NEEDED = {  # to read images, and the file of the tracker or of the virtual robot
    **{name: {"cv2", "pydantic"} for name in ("calibrate_camera", "markers", "track")},
    **{name: {"pydantic"} for name in ("bench_tests", "tracker_node")},
}


@pytest.mark.parametrize(
    ("name", "target"), [(name, target) for (_, name), target in entry_points().items()]
)
def test_help_loads_no_slow_package(name, target):
    module, function = target.split(":")
    code = LOADED.replace("MODULE", repr(module)).replace("FUNCTION", function)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    absent = SLOW - NEEDED.get(name, set())
    absent |= {"numpy", "rosbags"} if name in LIGHTEST else set()
    assert not absent & set(done.stdout.split("\n")[-2].split())
