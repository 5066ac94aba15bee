# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from study_cases import SMALL

from worm_model.parameters import PAPER, ParameterFile, write_parameter_file
from worm_optimizer.evaluation.servo_limits import servo_models
from worm_optimizer.study.study_file import StudyError, load_study, parse_study

HERE = Path()


def changed(**changes: object) -> str:
    """Return the small study with some keys changed; None removes one."""
    content = {**yaml.safe_load(SMALL), **changes}
    return yaml.safe_dump({key: value for key, value in content.items() if value is not None})


def test_a_grid_holds_every_combination_once():
    study = parse_study(SMALL, HERE)
    points = study.points()
    assert study.varied == ("parameter_file", "slack", "switching_threshold")
    assert study.size == 6
    assert study.dimensions == {
        "slack": (0.004, 0.008, 0.012),
        "switching_threshold": (0.008, 0.0175),
    }
    assert points.shape == (6, 3)
    assert points[4].tolist() == [0.0, 0.012, 0.008]
    assert {tuple(row[1:]) for row in points} == {
        (slack, threshold) for slack in (0.004, 0.008, 0.012) for threshold in (0.008, 0.0175)
    }


def test_samples_fill_their_ranges_and_repeat_with_their_seed():
    vary = {"slack": {"range": [0.002, 0.01]}, "gain": {"range": [0.7, 0.9]}, "direction": [1, -1]}
    sample = {"points": 50, "seed": 4}
    study = parse_study(changed(vary=vary, sample=sample), HERE)
    assert study.shape == (2, 50)
    points = study.points()
    slack, gain = points[:, study.varied.index("slack")], points[:, study.varied.index("gain")]
    assert study.size == 100
    assert slack.min() > 0.002
    assert slack.max() < 0.01
    # each tenth of each range contains about a tenth of the points: five of fifty in either direction
    for values, low, high in ((slack, 0.002, 0.01), (gain, 0.7, 0.9)):
        counts = np.histogram(values, bins=10, range=(low, high))[0]
        assert counts.sum() == 100
        assert counts.min() >= 4
    again = parse_study(changed(vary=vary, sample=sample), HERE).points()
    assert np.array_equal(study.points(), again)
    other = parse_study(changed(vary=vary, sample={**sample, "seed": 5}), HERE)
    assert not np.array_equal(study.points(), other.points())


RANGES = {"slack": {"range": [0.002, 0.01]}, "gain": {"range": [0.7, 0.9]}}


@given(fewer=st.integers(0, 5), more=st.integers(0, 5), seed=st.integers(0, 2**32 - 1))
def test_a_larger_sample_begins_with_the_smaller_one(fewer, more, seed):
    few, many = (
        parse_study(changed(vary=RANGES, sample={"points": 2**size, "seed": seed}), HERE)
        for size in (fewer, fewer + more)
    )
    assert np.array_equal(many.points()[: few.size], few.points())
    assert few.identity() == many.identity()


def test_all_that_determines_a_result_is_in_the_identity(tmp_path):
    (tmp_path / "driver.yaml").write_text(
        "driver:\n  ros__parameters:\n    limits.max_stroke_m: 0.08\n    i2c_bus: ''\n"
    )
    robot = ParameterFile(PAPER.replace(gain=0.85), {"gain": (0.8, 0.9)})
    write_parameter_file(tmp_path / "robot.yaml", robot)
    hardware = {"driver": "driver.yaml", "servo_model": min(servo_models())}
    own = {"parameter_files": ["robot.yaml"], "hardware": hardware}

    def identity(**changes: object) -> str:
        return parse_study(changed(**{**own, **changes}), tmp_path).identity()

    same = identity()
    more = {"slack": [0.004], "switching_threshold": [0.0175]}
    assert {identity(title="other"), identity(vary=more)} == {same}
    different = [
        identity(hardware={**hardware, "supply_voltage_V": 5.0}),
        identity(parameter_files=None),
        identity(fixed={"margin_m": 0.001}),
        identity(fixed={"margin_m": "cliff"}),
        identity(vary={"slack": [0.004]}),
        identity(compute=["gaits"]),
        identity(resolution={"strokes": 11}),
        identity(scan={"highest_m": 0.004}),
        identity(waveform="shaped"),
    ]
    assert len({same, *different}) == 10


def test_parameter_files_are_an_axis(tmp_path):
    for name, slack in (("a.yaml", 0.006), ("b.yaml", 0.007)):
        write_parameter_file(tmp_path / name, ParameterFile(PAPER.replace(slack=slack)))
    (tmp_path / "study.yaml").write_text(
        changed(parameter_files=["a.yaml", "b.yaml"], vary={"gain": [0.8, 0.86]})
    )
    study = load_study(tmp_path / "study.yaml")
    assert [content.parameters.slack for _, content in study.files] == [0.006, 0.007]
    assert study.points()[:, 0].tolist() == [0.0, 0.0, 1.0, 1.0]


WRONG: list[tuple[list[str], dict[str, object]]] = [
    (["vary", "'slak'", "slack"], {"vary": {"slak": [1.0]}}),
    (["vary", "'one_sided_cable'"], {"vary": {"one_sided_cable": [0.0, 1.0]}}),
    (["vary: slack", "'much'"], {"vary": {"slack": ["much"]}}),
    (["vary: slack", "list"], {"vary": {"slack": {"from": 0.0}}}),
    (["vary: slack", "twice"], {"vary": {"slack": [0.001, 0.001]}}),
    (["vary: slack", "8 m", "0 to 0.1 m"], {"vary": {"slack": [0.004, 8.0]}}),
    (["vary: slack: count", "2.5"], {"vary": {"slack": {"from": 0.0, "to": 0.01, "count": 2.5}}}),
    (["vary: slack: range", "-0.1 m", "0 to 0.1 m"], {"vary": {"slack": {"range": [-0.1, 0.1]}}}),
    (["fixed: margin_m", "3.4 m", "0 to 0.1 m"], {"fixed": {"margin_m": 3.4}}),
    (["max_ramp_share", "waveform: shaped"], {"vary": {"max_ramp_share": [0.1, 0.2]}}),
    (["any_phase", "waveform"], {"compute": ["any_phase"], "waveform": "shaped"}),
    (["waveform", "'square'", "shaped"], {"waveform": "square"}),
    (["fixed: max_power_W", "0 W"], {"fixed": {"max_power_W": 0.0, "margin_m": 0.0}}),
    (["sample: points", "0"], {"vary": RANGES, "sample": {"points": 0}}),
    (["sample", "range"], {"vary": {"slack": {"range": [0.001, 0.01]}}}),
    (["vary: direction", "2"], {"vary": {"direction": [2]}}),
    (["vary: direction", "list of 1 and -1"], {"vary": {"direction": {"range": [-1, 1]}}}),
    (["slack", "vary", "fixed"], {"fixed": {"slack": 0.01, "margin_m": 0.0}}),
    (["compute: front", "margin"], {"fixed": None}),
    (["compute", "'fronts'", "front"], {"compute": ["fronts"]}),
    (["resolution: strokes", "3", "2"], {"resolution": {"strokes": 2}}),
    (["spool_radius_m", "servo"], {"vary": {"spool_radius_m": [0.02]}}),
    (
        ["groove_phase_m", "initial_length"],
        {"vary": {"groove_phase_m": [0.0], "initial_length": [0.3]}},
    ),
    (["hardware: driver", "missing"], {"hardware": {"servo_model": "XL330-M288"}}),
    (["vary"], {"vary": None}),
    (
        ["vary", "100000000 points"],
        {
            "vary": {
                "slack": {"from": 0.001, "to": 0.01, "count": 10_000},
                "gain": {"from": 0.5, "to": 0.9, "count": 10_000},
            }
        },
    ),
    (["'varies'", "vary"], {"varies": {}}),
]


@pytest.mark.parametrize(("facts", "changes"), WRONG)
def test_an_invalid_study_is_rejected_in_one_line(facts, changes, tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(changed(**changes))
    with pytest.raises(StudyError) as raised:
        load_study(file)
    message = str(raised.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    assert [fact for fact in facts if fact not in message.removeprefix(str(tmp_path))] == []
