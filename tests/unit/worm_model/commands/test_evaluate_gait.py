# SPDX-License-Identifier: Apache-2.0
"""The command lines evaluate_gait and phase_map, as scripts use them."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from worm_model.commands import evaluate_gait as command
from worm_model.commands import phase_map
from worm_model.gait import Gait, Profile
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_model.simulation.closed_form import cliff_margin
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.conditions import Conditions

KEYS = (
    "stroke frequency direction margin speed power cost_of_transport grooves_per_cycle groove_phase"
).split()


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    def call(main, *arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["command", *arguments])
        try:
            status = main()
        except SystemExit as leave:
            status = leave.code
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


def test_json_is_one_object_with_the_contracts_keys(run) -> None:
    status, out, err = run(
        command.main, "--stroke", "0.07", "--frequency", "0.2", "--margin", "0.0034", "--json"
    )
    gait = json.loads(out)
    assert (status, err) == (0, "")
    assert set(KEYS) <= set(gait)
    expected = evaluate_gait(Gait(0.07, 0.2, 1, 0.0034))
    assert gait["speed"] == expected.speed
    assert gait["power"] == expected.power
    assert gait["groove_phase"] == pytest.approx(0.0011)


def test_groove_phase_is_printed_next_to_the_speed(run) -> None:
    status, out, _ = run(command.main, "--stroke", "0.07", "--frequency", "0.2")
    assert status == 0
    speed = next(line for line in out.splitlines() if line.startswith("speed"))
    assert "3.4600 mm/s" in speed
    assert "groove phase of +1.10 mm" in speed


def test_results_that_rounding_decides_are_named(run, tmp_path) -> None:
    low, high = 0.07, 0.0755  # one and two grooves per cycle; between them lies an edge
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle) if evaluate_gait(Gait(middle, 0.15)).min_grooves > 1.5 else (middle, high)
        )
    at_edge = "--stroke", repr(high), "--frequency", "0.15"
    assert "1.000 to 2.000 grooves per cycle" in run(command.main, *at_edge)[1]
    (decided,) = json.loads(run(command.main, *at_edge, "--json")[1])["decided_by_rounding"]
    assert "grooves" in decided
    clear = "--stroke", "0.0755", "--frequency", "0.15"
    assert json.loads(run(command.main, *clear, "--json")[1])["decided_by_rounding"] == []
    (tmp_path / "stiff.yaml").write_text(
        "rear_mass: 2.9162\nfront_mass: 0.059622\nviscous_friction: 20769\ntime_constant: 10\n"
    )
    beyond = (
        "--stroke 0.095884 --frequency 2.0557 --pretension 0.0077588 --profile trapezoid".split()
    )
    shape = "--contraction-share", "0.012671", "--ramp-share", "0.4991"
    file = "--parameters", str(tmp_path / "stiff.yaml")
    found = json.loads(run(command.main, *beyond, *shape, *file, "--json")[1])
    assert any(" W" in text for text in found["decided_by_rounding"])
    assert found["power"] >= 0.82


def test_infinite_cost_of_transport_is_null_in_json(run) -> None:
    _, out, _ = run(command.main, "--stroke", "0.007", "--frequency", "0.2", "--json")
    assert json.loads(out)["cost_of_transport"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--stroke 0.07 --frequency -0.2", "frequency: -0.2 Hz"),
        ("--stroke nan --frequency 0.2", "--stroke"),
        ("--stroke 0.07", "--frequency"),
        ("--stroke 70 --frequency 0.2", "stroke: 70"),
        ("--stroke 0.07 --frequency 0.2 --direction 2", "--direction"),
        ("--stroke 0.07 --frequency 0.2 --parameters none.yaml", "none.yaml: cannot be read"),
        ("--gaits none.csv", "--output"),
        ("--gaits none.csv --output out.csv", "none.csv: cannot be read"),
        ("--gaits none.csv --output nowhere/out.csv", "nowhere does not exist"),
    ],
)
def test_bad_input_is_one_line_and_status_2(run, arguments: str, message: str) -> None:
    status, out, err = run(command.main, *arguments.split())
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_table_has_the_references_columns_and_further_parameters(run, tmp_path: Path) -> None:
    source, target = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text(
        "stroke_m,frequency_Hz,margin_m,L0_m,direction,viscous_friction\n"
        "0.07,0.2,0,0.2952,1,86.97\n0.0755,0.15,0.0034,0.2952,-1,95\n"
    )
    status, _, _ = run(command.main, "--gaits", str(source), "--output", str(target))
    assert status == 0
    with target.open() as file:
        rows = list(csv.DictReader(file))
    expected = evaluate_gait(Gait(0.0755, 0.15, -1, 0.0034), PAPER.replace(viscous_friction=95.0))
    assert float(rows[1]["speed_m_s"]) == pytest.approx(expected.speed, rel=1e-12)
    assert float(rows[1]["power_W"]) == pytest.approx(expected.power, rel=1e-9)
    assert int(rows[1]["switches_5_cycles"]) == expected.switches
    assert float(rows[1]["viscous_friction"]) == 95.0
    again, _, err = run(command.main, "--gaits", str(source), "--output", str(target))
    assert again == 2
    assert "out.csv: exists" in err


def test_reference_table_comes_back_with_its_columns(run, shared: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    source = shared / "reference" / "gaits.csv"
    assert run(command.main, "--gaits", str(source), "--output", str(target))[0] == 0
    with source.open() as file:
        columns = next(csv.reader(file))
    with target.open() as file:
        assert next(csv.reader(file))[: len(columns)] == columns


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no column stroke_m"),
        ("stroke_m,frequency_Hz\n", "contains no gait"),
        ("stroke_m,frequency_Hz\n0.07\n", "line 2, column frequency_Hz"),
        ("stroke_m,frequency_Hz\n0.07,x\n", "'x' is not a finite number"),
        ("stroke_m,frequency_Hz\n0.07,0.2,3\n", "line 2: 3 values for 2 columns"),
        ("stroke_m,frequency_Hz,speed\n0.07,0.2,3\n", "unknown column 'speed'"),
        ("stroke_m,frequency_Hz,L0_m,initial_length\n0.07,0.2,0.3,0.3\n", "appears twice"),
        ("stroke_m,frequency_Hz,pitch\n0.07,0.2,17\n", "pitch: 17 m is outside"),
    ],
)
def test_bad_tables_name_the_place(run, tmp_path: Path, text: str, message: str) -> None:
    source = tmp_path / "in.csv"
    source.write_text(text)
    output = tmp_path / "o.csv"
    status, _, err = run(command.main, "--gaits", str(source), "--output", str(output))
    assert status == 2
    assert message in err
    assert not output.exists()


def test_phase_map_counts_grooves_and_draws(run, tmp_path: Path) -> None:
    figure = tmp_path / "map.png"
    status, out, _ = run(
        phase_map.main, "--points", "12", "--frequency", "0.15", "--figure", str(figure), "--json"
    )
    content = json.loads(out)
    assert status == 0
    assert figure.stat().st_size > 10_000
    grooves, phases = content["grooves_per_cycle"], content["groove_phases"]
    assert len(grooves) == len(phases) == 12
    assert phases[-1] == pytest.approx(0.5 * PAPER.pitch)
    assert phases[0] > -0.5 * PAPER.pitch
    length = 17 * PAPER.pitch + phases[7]
    gait = Gait(content["stroke"][10], 0.15)
    expected = evaluate_gait(gait, PAPER.replace(initial_length=length)).grooves_per_cycle
    assert grooves[7][10] == round(expected)


def test_a_phase_map_of_a_shaped_gait_is_that_of_the_gait(run) -> None:
    shape = {"pretension": 0.012, "contraction_share": 0.7, "profile": "trapezoid"}
    options = [f"--{name.replace('_', '-')}={value}" for name, value in shape.items()]
    box = ("--points", "8", "--lowest", "0.06", "--highest", "0.07", "--json")
    content = json.loads(run(phase_map.main, *box, *options)[1])
    grooves, phases = content["grooves_per_cycle"], content["groove_phases"]
    for row, phase in enumerate(phases):
        robot = PAPER.replace(initial_length=17 * PAPER.pitch + phase)
        result = evaluate_gait(Gait(content["stroke"][4], 0.15, **shape), robot)
        assert grooves[row][4] == round(result.grooves_per_cycle)
        cliff = content["closed_form_cliff_margin"][row]
        assert cliff == pytest.approx(cliff_margin(robot, 1, 0.012))


def test_phase_map_rejects_invalid_input(run, tmp_path: Path) -> None:
    assert run(phase_map.main, "--points", "1")[0] == 2
    assert run(phase_map.main, "--lowest", "0.05", "--highest", "0.04")[0] == 2
    assert run(phase_map.main, "--frequency", "-1", "--points", "4")[0] == 2


def test_help_does_not_wait_for_the_compiler() -> None:
    code = (
        "import sys, worm_model.commands.evaluate_gait, worm_model.commands.simulate\n"
        "import worm_model.commands.bags\n"
        "sys.exit(bool({'numba', 'numpy', 'matplotlib', 'rosbags'} & set(sys.modules)))"
    )
    source = Path(command.__file__).resolve().parents[2]
    sources = f"{source}:{source.parent / 'worm_msgs'}"
    path = {"PYTHONPATH": sources, "PATH": "/usr/bin:/bin"}
    assert subprocess.run([sys.executable, "-c", code], env=path).returncode == 0


WAVEFORM = "--pretension 0.0115 --contraction-share 0.6 --profile trapezoid --ramp-share 0.1"


def test_conditions_and_waveform_are_options(run) -> None:
    status, out, err = run(
        command.main,
        *"--stroke 0.06 --frequency 0.2 --slope 10 --tether 0.5 --json".split(),
        *WAVEFORM.split(),
    )
    gait = json.loads(out)
    assert (status, err) == (0, "")
    assert gait["profile"] == "trapezoid"
    assert gait["conditions"]["slope_deg"] == 10.0
    expected = evaluate_gait(
        Gait(0.06, 0.2, 1, 0.0, 0.0115, 0.6, Profile.TRAPEZOID, 0.1),
        under(Conditions(slope_deg=10.0, tether_n=0.5), PAPER),
    )
    assert gait["power"] == expected.power
    assert gait["speed"] == expected.speed


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        ("--tether 200", "200 N"),
        ("--flow 1", "drag_area_m2"),
        ("--tether-length 1", "tether_n_per_m"),
        ("--profile sawtooth", "sawtooth"),
        ("--ramp-share 0.6", "ramp_share: 0.6"),
        ("--pretension 0.25", "stroke: 0.31 m"),
    ],
)
def test_bad_conditions_and_waveforms_are_one_line(run, options: str, fact: str) -> None:
    status, out, err = run(command.main, "--stroke", "0.06", "--frequency", "0.2", *options.split())
    assert (status, out) == (2, "")
    assert fact in err
    assert err.count("\n") == 1


def test_a_table_has_loads_and_waveforms(run, tmp_path: Path) -> None:
    source, output = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text(
        "stroke_m,frequency_Hz,rear_load,front_load,pretension_m,contraction_share,profile,ramp_share\n"
        "0.06,0.2,1,0.5,0.01,0.6,trapezoid,0.2\n0.07,0.2,0,0,0,0.5,cosine,0.25\n0.07,0.2,60,0,0,0.5,cosine,0.25\n"
    )
    status, out, _ = run(command.main, "--gaits", str(source), "--output", str(output), "--json")
    assert status == 0
    assert json.loads(out)["without_figures"] == [4]
    with output.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["profile"] for row in rows] == ["trapezoid", "cosine", "cosine"]
    first = Gait(0.06, 0.2, 1, 0.0, 0.01, 0.6, Profile.TRAPEZOID, 0.2)
    expected = evaluate_gait(first, PAPER.replace(rear_load=1.0, front_load=0.5))
    assert float(rows[0]["power_W"]) == pytest.approx(expected.power, rel=1e-8)
    assert float(rows[1]["power_W"]) == pytest.approx(evaluate_gait(Gait(0.07, 0.2)).power)
    assert rows[2]["speed_m_s"] == rows[2]["power_W"] == "nan"


def test_conditions_of_a_table_are_rejected(run, tmp_path: Path) -> None:
    source, output = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text("stroke_m,frequency_Hz\n0.07,0.2\n")
    status, _, err = run(
        command.main, "--gaits", str(source), "--output", str(output), "--slope", "10"
    )
    assert status == 2
    assert "rear_load" in err
    assert not output.exists()
