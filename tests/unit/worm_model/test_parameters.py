# SPDX-License-Identifier: Apache-2.0
"""The parameter file: accepted values, rejected values, and the facts in the messages."""

import inspect
import re
from pathlib import Path

import pytest

from worm_model.parameters import (
    KEYS,
    PAPER,
    SYMBOLS,
    UNITS,
    ParameterError,
    ParameterFile,
    Parameters,
    load_parameter_file,
    load_parameters,
    write_parameter_file,
)
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.robot_parameters import TravelError

ROOT = Path(__file__).parents[3]
INSTALLED = ROOT / "src/worm_model/config/paper.yaml"


def test_installed_file_holds_the_defaults() -> None:
    assert load_parameters(INSTALLED) == PAPER
    assert load_parameters("") == PAPER


def test_the_representation_holds_what_differs_from_the_paper():
    assert repr(PAPER) == "Parameters()"
    own = PAPER.replace(gain=0.85, one_sided_cable=True)
    assert repr(own) == "Parameters(gain=0.85, one_sided_cable=True)"
    assert eval(repr(own), {"Parameters": Parameters}) == own
    assert len(str(inspect.signature(evaluate_gait))) < 200


def test_round_trip(tmp_path: Path) -> None:
    content = ParameterFile(
        PAPER.replace(gain=0.9, one_sided_cable=True),
        {"gain": (0.88, 0.92)},
        {"seed": 3, "bags": {"a": "b"}},
        correlations={("slack", "gain"): 0.93, ("gain", "time_constant"): -0.2},
        run_to_run={"initial_length": 4e-4},
        travel_error=TravelError(-0.0012, 0.0004),
    )
    write_parameter_file(tmp_path / "p.yaml", content)
    assert load_parameter_file(tmp_path / "p.yaml") == content
    assert "one_sided_cable: true" in (tmp_path / "p.yaml").read_text()
    assert "one_sided_cable" not in KEYS
    assert load_parameters(INSTALLED).one_sided_cable is False
    with pytest.raises(FileExistsError):
        write_parameter_file(tmp_path / "p.yaml", content)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("correlations: [[slack, gain]]", "correlations: .* is missing"),
        ("correlations: [[slack, gian, 0.5]]", "did you mean gain"),
        ("correlations: [[slack, slack, 0.5]]", "correlations: slack, slack"),
        ("correlations: [[slack, gain, 1.5]]", "less than or equal to 1"),
        ("travel_error: {value: -0.001, sd: -0.1}", "greater than or equal to 0"),
        ("run_to_run: {slak: 0.1}", "did you mean slack"),
        ("run_to_run: {slack: -0.1}", "slack must be greater than or equal to 0"),
        ("viscous_frition: 90", "did you mean viscous_friction"),
        ("pitch: 17.3", "is it in another unit"),
        ("engaged_stiffness: -1833", r"k_eng, N/m"),
        ("rear_mass: .nan", "finite number"),
        ("switching_threshold: 0.008", "switch back at once"),
        ("clearance: 0.04", "never touch the grooves"),
        ("- 1", "the file must be a mapping"),
        ("a: [", "not valid YAML at line"),
        ("intervals: {gain: [1.0, 0.5]}", "intervals: gain: .* 1 .* 0.5"),
        ("provenance: 7", "provenance"),
        ("one_sided_cable: 1", "valid boolean"),
        ("intervals: {one_sided_cable: [0, 1]}", "intervals: a key must be"),
        ("one_sided_cable: true", "identify --one-sided-cable"),
        ("{one_sided_cable: true, power_factor: 3.0}", "needs bellows_damping and power_factor"),
        (
            "{one_sided_cable: true, power_factor: 3.0, bellows_damping: 900.0, "
            "provenance: {made_by: worm_model identify}}",
            "identify again with --one-sided-cable",
        ),
        (
            "provenance: {made_by: worm_model identify, one_sided_cable: true}",
            "identify again without --one-sided-cable",
        ),
    ],
)
def test_bad_files_are_rejected_in_one_line(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=expected) as caught:
        load_parameters(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_unreadable_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="cannot be read"):
        load_parameters(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ParameterError, match=r"binary\.yaml"):
        load_parameters(tmp_path / "binary.yaml")


def test_the_table_of_the_docs_is_that_of_the_code() -> None:
    """Each parameter has a cell with its symbol, key, default and unit."""
    text = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
    for key in KEYS:
        unit = "" if UNITS[key] == "1" else f" {UNITS[key]}"
        row = rf"\| {re.escape(SYMBOLS[key])} \| `{key}` \| ([0-9.]+){unit}(?:, \*\*ours\*\*)? \|"
        found = re.findall(row, text)
        assert [float(value) for value in found] == [getattr(PAPER, key)], key
