# SPDX-License-Identifier: Apache-2.0
"""A typical change is one edit: a copy of the sources gets one more entry, and the whole chain handles it.

The copies run in processes of their own with an uncompiled kernel, which takes milliseconds per gait. Where the edit
is outside of the kernel and the run is long, one edited module stands before the original, and the kernel is compiled.
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("worm_msgs", "worm_driver", "worm_model", "worm_optimizer")


def run_code(code: str, folder: Path, environment: dict[str, str]) -> dict:
    """Run code in a process of its own and return the JSON object that it prints last."""
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def replaced(text: str, before: str, after: str) -> str:
    """Replace a part of a text that occurs once."""
    assert text.count(before) == 1, before
    return text.replace(before, after)


class Copy:
    """Copy of the sources that a test may edit."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for package in PACKAGES:
            shutil.copytree(
                ROOT / "src" / package,
                folder / package,
                ignore=shutil.ignore_patterns("__pycache__", "*.md", "fronts"),
            )

    def edit(self, file: str, before: str, after: str) -> None:
        """Replace a text that occurs at one place."""
        path = self.folder / file
        text = path.read_text(encoding="utf-8")
        path.write_text(replaced(text, before, after), encoding="utf-8")

    def run(self, code: str) -> dict:
        """Run code on the copy and return the JSON object that it prints last."""
        path = os.pathsep.join(str(self.folder / package) for package in PACKAGES)
        environment = os.environ | {"PYTHONPATH": path, "NUMBA_DISABLE_JIT": "1"}
        environment.pop("AMENT_PREFIX_PATH", None)  # definitions of messages come from the copy
        return run_code(code, self.folder, environment)


@pytest.fixture
def copy(tmp_path):
    return Copy(tmp_path / "src")


PARAMETER = """
import dataclasses, json, sys
from pathlib import Path
import numpy as np, yaml
from worm_model.gait import Gait
from worm_model.identification.reference_values import reference_by_file
from worm_model.parameters import KEYS, PAPER, ParameterFile, format_parameter_file, parse_parameter_file
from worm_model.simulation.gait_table import evaluate_table, read_gaits, write_table
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.robustness.uncertainty import phase_known
from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE, load_settings

loaded = PAPER.replace(rear_pull=1.0)
content = ParameterFile(loaded, {"rear_pull": (0.5, 1.5), "front_pull": (-0.5, 0.5)})
again = parse_parameter_file(yaml.safe_load(format_parameter_file(content)))
Path("gaits.csv").write_text("stroke_m,frequency_Hz,rear_pull\\n0.07,0.2,1.0\\n")
overrides, table = evaluate_table(read_gaits("gaits.csv"), PAPER)
write_table(Path("out.csv"), table, overrides, PAPER)
draws = phase_known(content, 500, 1).overrides
robot = yaml.safe_load(DEFAULT_FILE.read_text())
robot["body"]["rear_pull"] = -2.0
Path("robot.yaml").write_text(yaml.safe_dump(robot))
run = run_offline(load_settings(Path("robot.yaml")), lambda time: 0.0, 0.1, rest=0.1)
print(json.dumps({
    "keys": list(KEYS)[-2:],
    "round_trip": again == content,
    "speed": evaluate_gait(Gait(0.07, 0.2), loaded).speed,
    "speed_of_table": float(table.speed[0]),
    "column": "rear_pull" in Path("out.csv").read_text().splitlines()[0],
    "drawn": [float(np.ptp(draws[key])) for key in ("rear_pull", "front_pull")],
    "below_zero": float(np.mean(draws["front_pull"] < 0.0)),
    "truth": type(loaded)(**dataclasses.asdict(run.truth)).rear_pull,
    "estimate": reference_by_file(content, "a file").estimate("rear_pull").low,
}))
"""


@pytest.mark.night
def test_a_parameter_is_a_row_of_the_table(copy):
    """Every step from the parameter file to draws and plant includes it; only the equations are added by hand."""
    row = '    front_load: float = _row(0.0, "N", -1e3, 1e3, "Q2")\n'
    more = "".join(
        f'    {key}_pull: float = _row(0.0, "N", -1e3, 1e3, "R{n}")\n'
        for n, key in enumerate(("rear", "front"), 1)
    )
    copy.edit("worm_msgs/worm_msgs/robot_parameters.py", row, row + more)
    seen = copy.run(PARAMETER)
    assert seen["keys"] == ["rear_pull", "front_pull"]
    assert all(seen[step] for step in ("round_trip", "column"))
    assert seen["speed"] == pytest.approx(0.0173 * 0.2, rel=1e-6)
    assert seen["speed_of_table"] == pytest.approx(seen["speed"], rel=1e-9)
    assert all(width > 0.5 for width in seen["drawn"])
    assert 0.4 < seen["below_zero"] < 0.6
    assert seen["truth"] == -2.0
    assert seen["estimate"] == 0.5


GAIT = """
import dataclasses, json
from pathlib import Path
import numpy as np
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.bags.run_writer import write_run
from worm_model.analysis.run_metrics import last_played_gait
from worm_model.analysis.simulated_run import simulated_run
from worm_model.commands.evaluate_gait import _parser
from worm_msgs.gait import GAIT_COLUMNS, Gait, gait_of
from worm_model.parameters import PAPER
from worm_model.simulation.gait_table import evaluate_table, read_gaits, write_table
from worm_model.twin.core.memory import MEMORY
from worm_model.twin.recorded_samples import rows_of_run
from worm_model.twin.data.samples import driver_state_of
from worm_model.twin.data.samples import SampleKind
from worm_optimizer.report.expectation import expect
from worm_optimizer.robustness.prediction import predict
from worm_optimizer.evaluation.task import MarginTask
from worm_model.parameters import ParameterFile

gait = Gait(0.07, 0.2, ripple_share=0.4)
run = simulated_run(gait, PAPER, 2, 50.0).as_recorded()
with new_bag(Path("new")) as writer:
    write_run(writer, run, "/worm")
with open_bag(Path("new")) as bag:
    again = read_run(bag)
with open_bag(Path(OLD)) as bag:
    old = read_run(bag)
rows = rows_of_run(again)
Path("gaits.csv").write_text("stroke_m,frequency_Hz,ripple_share\\n0.07,0.2,0.4\\n")
overrides, table = evaluate_table(read_gaits("gaits.csv"), PAPER)
write_table(Path("out.csv"), table, overrides, PAPER)
some = np.array([0.07]), np.array([0.2]), np.array([0.0])
prediction = predict(MarginTask(), ParameterFile(), *some, 2, 1)[0]
options = _parser().parse_args(["--stroke", "0.07", "--frequency", "0.2", "--ripple-share", "0.4"])
print(json.dumps({
    "bag": last_played_gait(again.gait_state).gait == gait,
    "old": sorted({float(v) for v in old.gait_state.ripple_share}),
    "twin": driver_state_of(rows[rows["kind"] == SampleKind.GAIT][1]).gait == gait,
    "memory": "ripple_share" in (MEMORY.names or ()),
    "table": float(table.gait["ripple_share"][0]),
    "header": Path("out.csv").read_text().splitlines()[0].split(","),
    "prediction": prediction.gait.ripple_share,
    "expected": expect(gait, ParameterFile()).robust.gait == gait,
    "options": gait_of(options) == gait,
    "rebuilt": dataclasses.replace(gait, margin=0.001).ripple_share,
}))
"""


@pytest.mark.night
def test_a_field_of_the_gait_is_a_field_of_its_two_declarations(copy):
    """After the message and the dataclass, only the waveform is added by hand."""
    field = '    ramp_share: float = _row("1", "accelerated share of contraction and extension", 0.25)\n'
    more = '    ripple_share: float = _row("1", "share of a cycle", 0.375)\n'
    copy.edit("worm_msgs/worm_msgs/gait.py", field, field + more)
    message = copy.folder / "worm_msgs/msg/Gait.msg"
    message.write_text(
        message.read_text(encoding="utf-8") + "float64 ripple_share\n", encoding="utf-8"
    )
    shutil.copytree(ROOT / "bags" / "forward", copy.folder / "forward")
    seen = copy.run(GAIT.replace("OLD", "'forward'"))
    assert all(seen[step] for step in ("bag", "twin", "memory", "expected", "options"))
    assert seen["old"] == [0.375]
    assert seen["table"] == seen["rebuilt"] == 0.4
    assert "ripple_share" in seen["header"]
    assert seen["prediction"] == 0.375


CAUSE = """
import importlib.util, json, sys
from dataclasses import replace
sys.path[:0] = [ROOT, ROOT + "/tests"]
import numpy as np
import worm_model.twin
worm_model.twin.__path__.insert(0, ".")
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.twin.cause_table import EVENT_CODES, LASTING
from worm_model.twin.causes import Candidate, Data, weigh_causes
from worm_model.twin.cycle_data import CycleData, Step
from worm_model.twin.diagnosis import History, judge_causes
from worm_model.twin.signatures import signatures
from benchmarks.twin_diagnosis import KINDS

spec = importlib.util.spec_from_file_location("generator", ROOT + "/docs/generate_interfaces.py")
generator = importlib.util.module_from_spec(spec)
spec.loader.exec_module(generator)

def findings(size):
    signs = signatures(Gait(0.08, 0.2), PAPER, driven=True)
    blank = [
        CycleData(n, np.zeros((3, 25)), np.full((3, 25), 1e-8), Step(0.0), True)
        for n in range(1, 5)
    ]
    data = Data(blank, (), signs)
    cause = LASTING["rear_dry_friction"]
    effect = size / cause.size * data.direction(Candidate(cause.up, cause.name, 3, 0.0))
    history, found = History(), []
    for cycle, values in zip(blank, effect.reshape(-1, 3, 25)):
        history = replace(history, cycles=(*history.cycles, replace(cycle, values=values)))
        weighed = weigh_causes(history.cycles, history.reported, signs, length_seen=True)
        history, some = judge_causes(history, cycle.number, weighed)
        found += some
    return signs, found

signs, found = findings(1.0)
print(json.dumps({
    "default": PAPER.rear_dry_friction,
    "signature": float(np.abs(signs.lasting["rear_dry_friction"]).max()),
    "codes": [finding.code.code for finding in found],
    "texts": [finding.text for finding in found],
    "message": generator.generated_message(generator.TWIN_EVENT.read_text()),
    "page": generator.generated_twin_page(generator.TWIN_PAGE.read_text()),
    "description": LASTING["rear_dry_friction"].describe(2.0, 0.2),
    "benchmark": KINDS["rear_dry_friction up"].code,
}))
"""


@pytest.mark.night
def test_a_cause_of_the_twin_is_a_row_of_the_table(tmp_path):
    """Signature, event, message, page and benchmark include it, also for a parameter that is 0 by default."""
    first = "#: lasting causes by name\nLASTING = {\n    row.name: row\n    for row in (\n"
    row = """        Cause(
            name="rear_dry_friction",
            effect=Effect.ABSOLUTE,
            up=EventCode("stick_up", "more dry friction", "dry friction has increased", "power"),
            down=EventCode("stick_down", "less dry friction", "dry friction has decreased", "power"),
            size=0.5,
            unit="N",
            description="dry friction of the rear module changed by {}",
            hint="dirt",
            trials=((0.2, 0.5, 1.0),),
        ),
"""
    table = ROOT / "src" / "worm_model" / "worm_model" / "twin" / "cause_table.py"
    edited = replaced(table.read_text(encoding="utf-8"), first, first + row)
    (tmp_path / table.name).write_text(edited, encoding="utf-8")
    seen = run_code(CAUSE.replace("ROOT", repr(str(ROOT))), tmp_path, dict(os.environ))
    assert seen["default"] == 0.0
    assert seen["signature"] > 0.0
    assert seen["codes"] == ["stick_up"]
    assert "dry friction of the rear module" in seen["texts"][0]
    assert seen["description"] == "dry friction of the rear module changed by +1.0 ± 0.2 N: dirt"
    assert 'string STICK_UP="stick_up"' in seen["message"]
    assert "| `stick_down` | dry friction has decreased | power |" in seen["page"]
    assert seen["benchmark"] == "stick_up"


def test_the_declarations_of_the_gait_agree():
    """Message and dataclass have the same fields."""
    from worm_msgs.gait import GAIT_UNITS
    from worm_msgs.msg import Gait as GaitMessage

    assert list(GaitMessage.get_fields_and_field_types()) == list(GAIT_UNITS)
