# SPDX-License-Identifier: Apache-2.0
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from study_cases import SMALL

from worm_model.parameters import PAPER, ParameterFile, write_parameter_file
from worm_optimizer.study.plan import StudyError, load_study, parse_study

HERE = Path()


def changed(**changes: object) -> str:
    """The small study with some keys changed; None removes one."""
    content = {**yaml.safe_load(SMALL), **changes}
    return yaml.safe_dump({key: value for key, value in content.items() if value is not None})


def test_a_grid_holds_every_combination_once():
    study = parse_study(SMALL, HERE)
    points = study.points()
    assert study.varied == ("parameter_file", "slack", "switching_threshold")
    assert study.size == 6
    assert points.shape == (6, 3)
    assert {tuple(row[1:]) for row in points} == {
        (slack, threshold) for slack in (0.004, 0.008, 0.012) for threshold in (0.008, 0.0175)
    }


def test_an_even_grid_holds_its_ends_and_plain_numbers():
    study = parse_study(changed(vary={"slack": {"from": 0.0, "to": 0.012, "count": 5}}), HERE)
    assert study.axes[0].values == (0.0, 0.003, 0.006, 0.009, 0.012)


@pytest.mark.parametrize("method", ["sobol", "latin_hypercube"])
def test_samples_fill_their_ranges_and_repeat_with_their_seed(method):
    vary = {"slack": {"range": [0.002, 0.01]}, "gain": {"range": [0.7, 0.9]}, "direction": [1, -1]}
    sample = {"method": method, "points": 50, "seed": 4}
    study = parse_study(changed(vary=vary, sample=sample), HERE)
    points = study.points()
    slack, gain = points[:, study.varied.index("slack")], points[:, study.varied.index("gain")]
    assert study.size == 100
    assert slack.min() > 0.002
    assert slack.max() < 0.01
    # each tenth of each range holds about a tenth of the points: five of fifty in either direction
    for values, low, high in ((slack, 0.002, 0.01), (gain, 0.7, 0.9)):
        counts = np.histogram(values, bins=10, range=(low, high))[0]
        assert counts.sum() == 100
        assert counts.min() >= 4
    assert np.array_equal(points, parse_study(changed(vary=vary, sample=sample), HERE).points())
    other = parse_study(changed(vary=vary, sample={**sample, "seed": 5}), HERE)
    assert not np.array_equal(points, other.points())


def test_parameter_files_are_an_axis(tmp_path):
    for name, slack in (("a.yaml", 0.006), ("b.yaml", 0.007)):
        write_parameter_file(tmp_path / name, ParameterFile(PAPER.replace(slack=slack)))
    (tmp_path / "study.yaml").write_text(
        changed(parameter_files=["a.yaml", "b.yaml"], vary={"gain": [0.8, 0.86]})
    )
    study = load_study(tmp_path / "study.yaml")
    assert [content.parameters.slack for _, content in study.files] == [0.006, 0.007]
    assert study.points()[:, 0].tolist() == [0.0, 0.0, 1.0, 1.0]


def test_blocks_cover_the_points_once_and_grow_with_the_points():
    study = dataclasses.replace(parse_study(SMALL, HERE), block_points=4)
    assert study.blocks == [slice(0, 4), slice(4, 6)]
    many = parse_study(
        changed(vary={"slack": {"from": 0.001, "to": 0.01, "count": 10_000}}, block_points=None),
        HERE,
    )
    assert many.block_points > 1
    assert len(many.blocks) >= 20


def test_a_title_or_a_comment_changes_nothing_that_counts():
    study = parse_study(SMALL, HERE)
    assert (
        parse_study(SMALL.replace("title: small", "title: other"), HERE).identity == study.identity
    )
    assert parse_study(SMALL.replace("0.012", "0.011"), HERE).identity != study.identity


WRONG = {
    "vary: no such key as 'slak'; did you mean slack": {"vary": {"slak": [1.0]}},
    "vary: no such key as 'one_sided_cable'": {"vary": {"one_sided_cable": [0.0, 1.0]}},
    "vary: slack: 'much' is not a finite number": {"vary": {"slack": ["much"]}},
    "vary: slack: write a list": {"vary": {"slack": {"from": 0.0}}},
    "vary: slack: a value stands there twice": {"vary": {"slack": [0.001, 0.001]}},
    "vary: slack: range: 0.1 is not below 0.1": {"vary": {"slack": {"range": [0.1, 0.1]}}},
    "sample: a range needs one": {"vary": {"slack": {"range": [0.001, 0.01]}}},
    "vary: direction: takes a list of 1 and -1": {"vary": {"direction": [2]}},
    "slack: stands under vary and under fixed": {"fixed": {"slack": 0.01, "margin_m": 0.0}},
    "compute: front needs a margin": {"fixed": None},
    "compute: no such key as 'fronts'; did you mean front": {"compute": ["fronts"]},
    "compute: expected a list": {"compute": None},
    "sample: nothing under vary has a range": {"sample": {"points": 4}},
    "resolution: strokes: 2 is not a whole number from 3": {"resolution": {"strokes": 2}},
    "resolution: no such key as 'tolerance_m'": {"resolution": {"tolerance_m": 0.5}},
    "scan: from 0.0 to -1.0 m": {"scan": {"highest_m": -1.0}},
    "spool_radius_m: says something only with a servo": {"vary": {"spool_radius_m": [0.02]}},
    "groove_phase_m: it sets initial_length": {
        "vary": {"groove_phase_m": [0.0], "initial_length": [0.3]}
    },
    "hardware: driver is missing": {"hardware": {"servo_model": "XL330-M288"}},
    "vary: nothing varies": {"vary": None},
    "vary: makes 100000000 points": {
        "vary": {
            "slack": {"from": 0.001, "to": 0.01, "count": 10_000},
            "gain": {"from": 0.5, "to": 0.9, "count": 10_000},
        }
    },
    "the file: no such key as 'varies'; did you mean vary": {"varies": {}},
    "block_points: 0 is not a whole number": {"block_points": 0},
}


@pytest.mark.parametrize("message", WRONG)
def test_what_cannot_be_used_is_one_line_that_says_why(message, tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(changed(**WRONG[message]))
    with pytest.raises(StudyError) as raised:
        load_study(file)
    assert str(raised.value).startswith(f"{file}: {message}")
    assert "\n" not in str(raised.value)


def test_a_broken_file_tells_its_line(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text("title: a\nvary: [\n")
    with pytest.raises(StudyError, match="is not valid YAML at line 3"):
        load_study(file)
    with pytest.raises(StudyError, match="cannot be read"):
        load_study(tmp_path / "absent.yaml")
