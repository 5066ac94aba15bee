# SPDX-License-Identifier: Apache-2.0
"""The command line evaluate_gait, as scripts use it."""

import csv
import json
from dataclasses import asdict
from pathlib import Path

import pytest

from worm_model.commands import evaluate_gait as command
from worm_model.gait import Gait, Profile
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.conditions import LEVEL, Conditions

KEYS = (
    "stroke frequency direction margin speed power cost_of_transport grooves_per_cycle groove_phase"
).split()


WAVEFORM = "--pretension 0.0115 --contraction-share 0.6 --profile trapezoid --ramp-share 0.1"
SHAPED = Gait(0.06, 0.2, 1, 0.0, 0.0115, 0.6, Profile.TRAPEZOID, 0.1)


@pytest.mark.parametrize(
    ("options", "gait", "conditions"),
    [
        ("--margin 0.0034", Gait(0.07, 0.2, 1, 0.0034), LEVEL),
        (f"--slope 10 --tether 0.5 {WAVEFORM}", SHAPED, Conditions(slope_deg=10.0, tether_n=0.5)),
    ],
)
def test_json_is_one_object_with_the_contracts_keys(run, options, gait, conditions) -> None:
    numbers = ("--stroke", gait.stroke, "--frequency", gait.frequency)
    status, out, err = run(command, *numbers, *options.split(), "--json")
    found = json.loads(out)
    assert (status, err) == (0, "")
    assert set(KEYS) <= set(found)
    assert found["profile"] == gait.profile.name.lower()
    assert found["conditions"] == asdict(conditions)
    expected = evaluate_gait(gait, under(conditions, PAPER))
    assert (found["speed"], found["power"]) == (expected.speed, expected.power)
    assert found["groove_phase"] == pytest.approx(0.0011)


def test_results_that_rounding_decides_are_named(run, tmp_path) -> None:
    low, high = 0.07, 0.0755  # one and two grooves per cycle; between them lies an edge
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (
            (low, middle) if evaluate_gait(Gait(middle, 0.15)).min_grooves > 1.5 else (middle, high)
        )
    at_edge = "--stroke", repr(high), "--frequency", "0.15"
    assert "1.000 to 2.000 grooves per cycle" in run(command, *at_edge)[1]
    (decided,) = json.loads(run(command, *at_edge, "--json")[1])["decided_by_rounding"]
    assert "grooves" in decided
    clear = "--stroke", "0.0755", "--frequency", "0.15"
    assert json.loads(run(command, *clear, "--json")[1])["decided_by_rounding"] == []
    (tmp_path / "stiff.yaml").write_text(
        "rear_mass: 2.9162\nfront_mass: 0.059622\nviscous_friction: 20769\ntime_constant: 10\n"
    )
    beyond = (
        "--stroke 0.095884 --frequency 2.0557 --pretension 0.0077588 --profile trapezoid".split()
    )
    shape = "--contraction-share", "0.012671", "--ramp-share", "0.4991"
    file = "--parameters", str(tmp_path / "stiff.yaml")
    found = json.loads(run(command, *beyond, *shape, *file, "--json")[1])
    assert any(" W" in text for text in found["decided_by_rounding"])
    assert found["power"] >= 0.82


def evaluated(run, source: Path, target: Path) -> tuple[dict, list[dict[str, str]]]:
    """Return the report on a table of gaits, and the rows of the written table."""
    status, out, _ = run(command, "--gaits", str(source), "--output", str(target), "--json")
    assert status == 0
    with target.open() as file:
        return json.loads(out), list(csv.DictReader(file))


def test_reference_table_comes_back(run, shared: Path, tmp_path: Path) -> None:
    source = shared / "reference" / "gaits.csv"
    _, rows = evaluated(run, source, tmp_path / "out.csv")
    with source.open() as file:
        expected = list(csv.DictReader(file))
    assert len(rows) == len(expected) == 16
    for row, reference in zip(rows, expected, strict=True):
        assert list(row)[: len(reference)] == list(reference)
        for name, rel, least in (
            ("speed_m_s", 1e-9, 1e-10),
            ("power_W", 1e-6, 0.0),
            ("switches_5_cycles", 0.0, 0.0),
            ("grooves_per_cycle", 0.0, 1e-6),
        ):
            assert float(row[name]) == pytest.approx(float(reference[name]), rel=rel, abs=least)


def test_a_table_has_parameters_loads_and_waveforms(run, tmp_path: Path) -> None:
    source, target = tmp_path / "in.csv", tmp_path / "out.csv"
    source.write_text(
        "stroke_m,frequency_Hz,margin_m,L0_m,direction,viscous_friction,rear_load,front_load,"
        "pretension_m,contraction_share,profile,ramp_share\n"
        "0.0755,0.15,0.0034,0.2952,-1,95,0,0,0,0.5,cosine,0.25\n"
        "0.06,0.2,0,0.2952,1,86.97,1,0.5,0.01,0.6,trapezoid,0.2\n"
        "0.07,0.2,0,0.2952,1,86.97,60,0,0,0.5,cosine,0.25\n"
    )
    report, rows = evaluated(run, source, target)
    assert report["without_figures"] == [4]
    assert [row["profile"] for row in rows] == ["cosine", "trapezoid", "cosine"]
    assert [float(row["viscous_friction"]) for row in rows] == [95.0, 86.97, 86.97]
    cases = (
        (Gait(0.0755, 0.15, -1, 0.0034), {"viscous_friction": 95.0}),
        (
            Gait(0.06, 0.2, 1, 0.0, 0.01, 0.6, Profile.TRAPEZOID, 0.2),
            {"rear_load": 1.0, "front_load": 0.5},
        ),
    )
    for row, (gait, changes) in zip(rows, cases, strict=False):
        expected = evaluate_gait(gait, PAPER.replace(**changes))
        assert float(row["speed_m_s"]) == pytest.approx(expected.speed, rel=1e-12)
        assert float(row["power_W"]) == pytest.approx(expected.power, rel=1e-8)
        assert int(row["switches_5_cycles"]) == expected.switches
    assert rows[2]["speed_m_s"] == rows[2]["power_W"] == "nan"


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
