# SPDX-License-Identifier: Apache-2.0
"""What --help imports: packages that load slowly make each command slow."""

import subprocess
import sys

import pytest

LOADED = """
import contextlib, importlib, sys
sys.argv = ["command", "--help"]
with contextlib.suppress(SystemExit):
    importlib.import_module(NAME).main()
print(*sys.modules)
"""


SLOW = {
    "distributed",
    "matplotlib",
    "numba",
    "pydantic",
    "pymoo",
    "rosbags.rosbag2",
    "scipy",
    "xarray",
}
LIGHTEST = ("bags", "evaluate_gait", "simulate")  # these also begin without NumPy and rosbags
COMMANDS = {
    "worm_driver.commands": ("calibrate", "check", "setup_servo"),
    "worm_model.commands": (
        *("bags", "evaluate_gait", "export", "health", "identify", "import_lab", "margin"),
        *("recover", "replay", "simulate"),
    ),
    "worm_model.nodes": ("play_node", "record_node"),
    "worm_optimizer.commands": (
        *("campaign", "capability", "console", "demo", "operate", "optimize", "report", "request"),
        *("scan_margin", "start", "study", "tune"),
    ),
}


@pytest.mark.parametrize(
    "name", [f"{package}.{name}" for package, names in COMMANDS.items() for name in names]
)
def test_help_loads_no_slow_package(name):
    code = f"NAME = {name!r}{LOADED}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    absent = SLOW | ({"numpy", "rosbags"} if name.endswith(LIGHTEST) else set())
    assert not absent & set(done.stdout.split("\n")[-2].split())
