# SPDX-License-Identifier: Apache-2.0
"""The command line evaluate_gait, as scripts use it."""

import csv
import json
from pathlib import Path

import pytest

from worm_model.commands import evaluate_gait as command
from worm_model.gait import Gait, Profile
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.conditions import Conditions

KEYS = (
    "stroke frequency direction margin speed power cost_of_transport grooves_per_cycle groove_phase"
).split()


def test_json_is_one_object_with_the_contracts_keys(run) -> None:
    status, out, err = run(
        command, "--stroke", "0.07", "--frequency", "0.2", "--margin", "0.0034", "--json"
    )
    gait = json.loads(out)
    assert (status, err) == (0, "")
    assert set(KEYS) <= set(gait)
    expected = evaluate_gait(Gait(0.07, 0.2, 1, 0.0034))
    assert gait["speed"] == expected.speed
    assert gait["power"] == expected.power
    assert gait["groove_phase"] == pytest.approx(0.0011)


def test_table_has_the_references_columns_and_further_parameters(run, tmp_path: Path) -> None:
    source, target = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text(
        "stroke_m,frequency_Hz,margin_m,L0_m,direction,viscous_friction\n"
        "0.07,0.2,0,0.2952,1,86.97\n0.0755,0.15,0.0034,0.2952,-1,95\n"
    )
    status, _, _ = run(command, "--gaits", str(source), "--output", str(target))
    assert status == 0
    with target.open() as file:
        rows = list(csv.DictReader(file))
    expected = evaluate_gait(Gait(0.0755, 0.15, -1, 0.0034), PAPER.replace(viscous_friction=95.0))
    assert float(rows[1]["speed_m_s"]) == pytest.approx(expected.speed, rel=1e-12)
    assert float(rows[1]["power_W"]) == pytest.approx(expected.power, rel=1e-9)
    assert int(rows[1]["switches_5_cycles"]) == expected.switches
    assert float(rows[1]["viscous_friction"]) == 95.0
    again, _, err = run(command, "--gaits", str(source), "--output", str(target))
    assert again == 2
    assert "out.csv: exists" in err


def test_reference_table_comes_back_with_its_columns(run, shared: Path, tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    source = shared / "reference" / "gaits.csv"
    assert run(command, "--gaits", str(source), "--output", str(target))[0] == 0
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
        ("stroke_m,frequency_Hz\n\n0.07,0.4\n\n0.05,x\n", "line 5, column frequency_Hz: 'x'"),
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
    status, _, err = run(command, "--gaits", str(source), "--output", str(output))
    assert status == 2
    assert message in err
    assert not output.exists()


WAVEFORM = "--pretension 0.0115 --contraction-share 0.6 --profile trapezoid --ramp-share 0.1"


def test_conditions_and_waveform_are_options(run) -> None:
    status, out, err = run(
        command,
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


def test_a_table_has_loads_and_waveforms(run, tmp_path: Path) -> None:
    source, output = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text(
        "stroke_m,frequency_Hz,rear_load,front_load,pretension_m,contraction_share,profile,ramp_share\n"
        "0.06,0.2,1,0.5,0.01,0.6,trapezoid,0.2\n0.07,0.2,0,0,0,0.5,cosine,0.25\n0.07,0.2,60,0,0,0.5,cosine,0.25\n"
    )
    status, out, _ = run(command, "--gaits", str(source), "--output", str(output), "--json")
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
