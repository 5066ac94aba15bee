# SPDX-License-Identifier: Apache-2.0
"""A typical change is one edit: a copy of the sources gets one more entry, and the whole chain handles it.

The copy runs in a process of its own with an uncompiled kernel, which takes milliseconds per gait.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.twin.cause_table import LASTING, Cause, Effect, EventCode
from worm_model.twin.causes import Candidate, Data, weigh_causes
from worm_model.twin.cycle_data import CycleData, Step
from worm_model.twin.signatures import signatures

SOURCES = Path(__file__).resolve().parents[2] / "src"
PACKAGES = ("worm_msgs", "worm_driver", "worm_model", "worm_optimizer")


def add(path: Path, before: str, added: str) -> None:
    """Add a text behind another one, which occurs once."""
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, before
    path.write_text(text.replace(before, before + added), encoding="utf-8")


SCRIPT = """
import json
from pathlib import Path
import numpy as np, yaml
from worm_model.analysis.run_metrics import last_played_gait
from worm_model.analysis.simulated_run import simulated_run
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.bags.run_writer import write_run
from worm_model.commands.evaluate_gait import _parser
from worm_model.gait import Gait
from worm_model.parameters import PAPER, ParameterFile, format_parameter_file, parse_parameter_file
from worm_model.simulation.gait_table import evaluate_table, read_gaits, write_table
from worm_model.simulation.simulator import evaluate_gait
from worm_model.twin.data.samples import SampleKind, driver_state_of
from worm_model.twin.recorded_samples import RecordedSamples
from worm_msgs.gait import gait_of
from worm_optimizer.report.expectation import expect
from worm_optimizer.robustness.uncertainty import phase_known
from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE, load_settings

loaded = PAPER.replace(rear_pull=1.0)
content = ParameterFile(loaded, {"rear_pull": (0.5, 1.5)})
robot = yaml.safe_load(DEFAULT_FILE.read_text())
robot["body"]["rear_pull"] = -2.0
Path("robot.yaml").write_text(yaml.safe_dump(robot))
virtual = run_offline(load_settings(Path("robot.yaml")), lambda time: 0.0, 0.1, rest=0.1)

gait = Gait(0.07, 0.2, ripple_share=0.4)
with new_bag(Path("new")) as writer:
    write_run(writer, simulated_run(gait, PAPER, 2, 50.0).as_recorded(), "/worm")
with open_bag(Path("new")) as bag:
    run = read_run(bag)
with open_bag(Path("forward")) as bag:
    old = read_run(bag)
rows = np.concatenate([*RecordedSamples(lambda: (run,)).rows()])
options = _parser().parse_args(["--stroke", "0.07", "--frequency", "0.2", "--ripple-share", "0.4"])

Path("gaits.csv").write_text("stroke_m,frequency_Hz,rear_pull,ripple_share\\n0.07,0.2,1.0,0.4\\n")
overrides, table = evaluate_table(read_gaits("gaits.csv"), PAPER)
write_table(Path("out.csv"), table, overrides, PAPER)
print(json.dumps({
    "speed": [evaluate_gait(Gait(0.07, 0.2), loaded).speed, float(table.speed[0])],
    "columns": Path("out.csv").read_text().splitlines()[0].split(","),
    "file": parse_parameter_file(yaml.safe_load(format_parameter_file(content))) == content,
    "drawn": float(np.ptp(phase_known(content, 500, 1).overrides["rear_pull"])),
    "truth": virtual.truth.rear_pull,
    "bag": last_played_gait(run.gait_state).gait == gait,
    "old": sorted({float(v) for v in old.gait_state.ripple_share}),
    "twin": driver_state_of(rows[rows["kind"] == SampleKind.GAIT][1]).gait == gait,
    "expected": expect(gait, ParameterFile()).robust.gait == gait,
    "options": gait_of(options) == gait,
}))
"""


@pytest.mark.night
def test_a_parameter_and_a_field_of_the_gait_are_each_a_row(tmp_path):
    """Only the equations are added by hand, and the field of the message."""
    for package in PACKAGES:
        unused = shutil.ignore_patterns("__pycache__", "*.md", "fronts")
        shutil.copytree(SOURCES / package, tmp_path / package, ignore=unused)
    shutil.copytree(SOURCES.parent / "bags" / "forward", tmp_path / "forward")
    messages = tmp_path / "worm_msgs"
    row = '    front_load: float = _row(0.0, "N", -1e3, 1e3, "Q2")\n'
    more = '    rear_pull: float = _row(0.0, "N", -1e3, 1e3, "R1")\n'
    add(messages / "worm_msgs" / "robot_parameters.py", row, more)
    row = '    ramp_share: float = _row("1", "accelerated share of contraction and extension", 0.25)\n'
    more = '    ripple_share: float = _row("1", "share of a cycle", 0.375)\n'
    add(messages / "worm_msgs" / "gait.py", row, more)
    with (messages / "msg" / "Gait.msg").open("a", encoding="utf-8") as message:
        message.write("float64 ripple_share\n")
    path = os.pathsep.join(str(tmp_path / package) for package in PACKAGES)
    environment = os.environ | {"PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}
    environment.pop("AMENT_PREFIX_PATH", None)  # definitions of messages come from the copy
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])
    assert seen["speed"] == pytest.approx([0.0173 * 0.2] * 2, rel=1e-6)
    assert {"rear_pull", "ripple_share"} <= set(seen["columns"])
    assert seen["drawn"] > 0.5
    assert seen["truth"] == -2.0
    assert seen["old"] == [0.375]
    assert all(seen[step] for step in ("file", "bag", "twin", "expected", "options"))


def test_a_cause_of_the_twin_is_a_row(monkeypatch):
    """Also for a parameter that is 0 by default. The interfaces page and TwinEvent.msg have tests of their own."""
    name = "rear_dry_friction"
    assert getattr(PAPER, name) == 0.0
    more, less = (EventCode(f"stick_{way}", way, way, "power") for way in ("up", "down"))
    row = Cause(name, Effect.ABSOLUTE, more, less, 0.5, "N", "friction changed by {}", "dirt", ())
    monkeypatch.setitem(LASTING, name, row)
    signs = signatures.__wrapped__(Gait(0.08, 0.2), PAPER, driven=True)  # the cache is for all
    blank = [
        CycleData(n, np.zeros((3, 25)), np.full((3, 25), 1e-8), Step(0.0), True)
        for n in range(1, 5)
    ]
    effect = 2.0 * Data(blank, (), signs).direction(Candidate(more, name, 3, 0.0))
    cycles = [
        replace(cycle, values=values)
        for cycle, values in zip(blank, effect.reshape(-1, 3, 25), strict=True)
    ]
    causes = weigh_causes(cycles, (), signs, length_seen=True)
    found = max(causes, key=lambda cause: cause.weight)
    assert found.code == more
    text = LASTING[found.name].describe(found.size, found.deviation)
    assert re.fullmatch(r"friction changed by \+1\.0 ± 0\.\d N: dirt", text)
