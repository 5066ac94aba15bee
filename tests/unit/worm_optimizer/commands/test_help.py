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


@pytest.mark.parametrize(
    ("name", "absent"),
    [
        *(
            (f"worm_model.commands.{name}", {"matplotlib", "numba", "numpy", "rosbags"})
            for name in ("bags", "evaluate_gait", "simulate")
        ),
        *(
            (f"worm_model.commands.{name}", {"matplotlib", "numba", "scipy"})
            for name in ("export", "health", "identify", "margin", "phase_map", "replay")
        ),
        *(
            (
                f"worm_optimizer.commands.{name}",
                {"matplotlib", "numba", "scipy", "xarray", "distributed"},
            )
            for name in ("report", "study")
        ),
        *(
            (f"worm_optimizer.commands.{name}", {"matplotlib"})
            for name in ("optimize", "request", "scan_margin", "capability", "sensitivity")
        ),
    ],
)
def test_help_loads_no_slow_package(name, absent):
    code = f"NAME = {name!r}{LOADED}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not absent & set(done.stdout.split("\n")[-2].split())
