# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_cases import changed, small_study

from worm_model.parameters import PAPER, ParameterFile, write_parameter_file
from worm_optimizer.study.study_file import StudyError, load_study


def test_a_grid_holds_every_combination_once():
    study = small_study()
    points = study.points()
    assert study.varied == ("parameter_file", "slack", "switching_threshold")
    assert study.file.dimensions == {
        "slack": (0.004, 0.008, 0.012),
        "switching_threshold": (0.008, 0.0175),
    }
    assert points.shape == (6, 3)
    assert points[4].tolist() == [0.0, 0.012, 0.008]
    assert {tuple(row[1:]) for row in points} == {
        (slack, threshold) for slack in (0.004, 0.008, 0.012) for threshold in (0.008, 0.0175)
    }


RANGES = {"slack": {"range": [0.002, 0.01]}, "gain": {"range": [0.7, 0.9]}}


def test_samples_fill_their_ranges():
    study = small_study(vary={**RANGES, "direction": [1, -1]}, sample={"points": 50, "seed": 4})
    assert study.file.shape == (2, 50)
    points = study.points()
    for name, low, high in (("slack", 0.002, 0.01), ("gain", 0.7, 0.9)):
        # each tenth of each range contains about a tenth of the points: five of fifty in either direction
        values = points[:, study.varied.index(name)]
        counts = np.histogram(values, bins=10, range=(low, high))[0]
        assert counts.sum() == 100
        assert counts.min() >= 4
    other = small_study(vary={**RANGES, "direction": [1, -1]}, sample={"points": 50, "seed": 5})
    assert not np.array_equal(study.points(), other.points())


@given(fewer=st.integers(0, 5), more=st.integers(0, 5), seed=st.integers(0, 2**32 - 1))
def test_a_larger_sample_begins_with_the_smaller_one(fewer, more, seed):
    few, many = (
        small_study(vary=RANGES, sample={"points": 2**size, "seed": seed})
        for size in (fewer, fewer + more)
    )
    assert np.array_equal(many.points()[: few.file.size], few.points())
    assert few.identity() == many.identity()


def test_all_that_determines_a_result_is_in_the_identity(tmp_path):
    robot = ParameterFile(PAPER.replace(gain=0.85), {"gain": (0.8, 0.9)})
    write_parameter_file(tmp_path / "robot.yaml", robot)

    def identity(**changes: object) -> str:
        (tmp_path / "study.yaml").write_text(changed(**changes))
        return load_study(tmp_path / "study.yaml").identity()

    same = identity()
    more = {"slack": [0.004], "switching_threshold": [0.0175]}
    assert {identity(title="other"), identity(vary=more)} == {same}
    different = [
        identity(parameter_files=["robot.yaml"]),
        identity(fixed={"margin_m": 0.001}),
        identity(fixed=None),
        identity(vary={"slack": [0.004]}),
        identity(compute=["gaits"]),
        identity(resolution={"strokes": 11}),
        identity(scan={"highest_m": 0.004}),
    ]
    assert len({same, *different}) == 8


def test_parameter_files_are_an_axis(tmp_path):
    for name, slack in (("a.yaml", 0.006), ("b.yaml", 0.007)):
        write_parameter_file(tmp_path / name, ParameterFile(PAPER.replace(slack=slack)))
    (tmp_path / "study.yaml").write_text(
        changed(parameter_files=["a.yaml", "b.yaml"], vary={"gain": [0.8, 0.86]})
    )
    study = load_study(tmp_path / "study.yaml")
    assert [content.parameters.slack for _, content in study.robots] == [0.006, 0.007]
    assert study.points()[:, 0].tolist() == [0.0, 0.0, 1.0, 1.0]
    with pytest.raises(StudyError, match="leave --parameters out"):
        load_study(tmp_path / "study.yaml", "a.yaml")


WRONG: list[tuple[list[str], dict[str, object]]] = [
    (["vary", "'slak'", "slack"], {"vary": {"slak": [1.0]}}),
    (["vary", "'one_sided_cable'"], {"vary": {"one_sided_cable": [0.0, 1.0]}}),
    (["vary: slack", "'1e-3'", "1.0e-3"], {"vary": {"slack": ["1e-3"]}}),
    (["vary: slack", "list"], {"vary": {"slack": {"from": 0.0}}}),
    (["vary: slack", "twice"], {"vary": {"slack": [0.001, 0.001]}}),
    (["vary: slack", "8.0", "0 to 0.1 m", "unit"], {"vary": {"slack": [0.004, 8.0]}}),
    (["vary: slack", "nan"], {"vary": {"slack": [float("nan")]}}),
    (["vary: slack", "count: N"], {"vary": {"slack": {"from": 0.0, "to": 0.01, "count": 2.5}}}),
    (["vary: slack", "not below"], {"vary": {"slack": {"from": 0.02, "to": 0.01, "count": 2}}}),
    (["vary: slack", "-0.1", "0 to 0.1 m"], {"vary": {"slack": {"range": [-0.1, 0.1]}}}),
    (["fixed: margin_m", "3.4", "0 to 0.1 m"], {"fixed": {"margin_m": 3.4}}),
    (["fixed: max_power_W", "0.0"], {"fixed": {"max_power_W": 0.0}}),
    (["sample: points", "0"], {"vary": RANGES, "sample": {"points": 0}}),
    (["vary: direction", "2"], {"vary": {"direction": [2]}}),
    (["slack", "vary", "fixed"], {"fixed": {"slack": 0.01}}),
    (["compute", "'fronts'", "front"], {"compute": ["fronts"]}),
    (["compute"], {"compute": None}),
    (["resolution: strokes", "3", "2"], {"resolution": {"strokes": 2}}),
    (["groove_phase_m", "initial_length"], {"vary": {"groove_phase_m": [0.0], "initial_length": [0.3]}}),
    (["vary"], {"vary": None}),
    (["parameter_files", "twice"], {"parameter_files": ["a.yaml", "a.yaml"]}),
    (
        ["vary", "100000000 points"],
        {"vary": {key: {"from": 0.5, "to": 0.9, "count": 10_000} for key in ("gain", "power_factor")}},
    ),
    (["'varies'", "vary"], {"varies": {}}),
]  # fmt: skip


@pytest.mark.parametrize(("facts", "changes"), WRONG)
def test_an_invalid_study_is_rejected_in_one_line(facts, changes, tmp_path: Path):
    file = tmp_path / "study.yaml"
    file.write_text(changed(**changes))
    with pytest.raises(StudyError) as raised:
        load_study(file)
    message = str(raised.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    assert [fact for fact in facts if fact not in message.removeprefix(str(tmp_path))] == []
