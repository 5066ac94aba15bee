# SPDX-License-Identifier: Apache-2.0
"""The virtual robot's file: what is refused, and with which words."""

import pytest
import yaml

from worm_driver.virtual_robot.plant import Conditions
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE, SettingsError, load_settings


def write(tmp_path, change):
    content = yaml.safe_load(DEFAULT_FILE.read_text())
    change(content)
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_the_installed_file_describes_the_standard_robot(settings):
    assert [(s.id, s.model.name) for s in settings.cable_servos] == [(1, "XM430-W350")]
    assert [(s.id, s.module) for s in settings.fin_servos] == [(11, "rear"), (12, "front")]


def test_its_truth_is_not_the_papers_table(settings):
    assert settings.body.bellows_damping != 862.4
    assert settings.body.switching_threshold != 0.0175


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["body"].update(colour=1), "unknown name 'colour'"),
        (lambda c: c["body"].pop("gain"), "'gain' is missing"),
        (lambda c: c["body"].update(pitch="wide"), "pitch must be a number"),
        (lambda c: c["body"].update(pitch=float("nan")), "pitch must be finite"),
        (lambda c: c["body"].update(pitch=-0.01), "pitch must be positive"),
        (lambda c: c.update(seed=1.5), "seed must be a whole number"),
        (lambda c: c.update(step_s=0.01), "step_s must be"),
        (lambda c: c["servos"].update(baud_rate=1234), "baud_rate must be one of"),
        (lambda c: c["cable_servos"][0].update(id=11), "the same id"),
        (lambda c: c["cable_servos"][0].update(id=253), "an id is 0 to 252"),
        (lambda c: c["cable_servos"][0].update(sign=0), "sign must be 1 or -1"),
        (lambda c: c["cable_servos"][0].update(model="XL320"), "no model 'XL320'"),
        (lambda c: c["fin_servos"][0].update(model="XL330-M288"), "takes 3.7 to 6.0 V"),
        (lambda c: c["fin_servos"].pop(), "both modules"),
        (lambda c: c.update(fin_servos=[]), "at least one servo"),
        (lambda c: c.update(tracker=3), "tracker must be a mapping"),
        (lambda c: c["conditions"].update(slope_deg=91), "slope_deg is 91"),
        (lambda c: c["conditions"].update(tether_n=-1), "tether_n is -1"),
        (lambda c: c["conditions"].update(tether_n_per_m=1e4), "tether_n_per_m is 10000"),
        (lambda c: c["conditions"].update(flow=1), "unknown name 'flow'"),
    ],
)
def test_what_is_refused(tmp_path, change, words):
    path = write(tmp_path, change)
    with pytest.raises(SettingsError, match=words) as caught:
        load_settings(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_one_that_is_no_yaml(tmp_path):
    with pytest.raises(SettingsError, match="No such file"):
        load_settings(tmp_path / "none.yaml")
    path = tmp_path / "bad.yaml"
    path.write_text("a: [1\n")
    with pytest.raises(SettingsError, match="no YAML"):
        load_settings(path)


def test_conditions_in_the_file_load_the_robot(tmp_path):
    stated = {"slope_deg": 20, "tether_n": 2, "tether_n_per_m": 0.5}
    loaded = load_settings(write(tmp_path, lambda c: c.update(conditions=stated)))
    assert loaded.conditions == Conditions(20.0, 2.0, 0.5)
    free = load_settings(write(tmp_path, lambda c: c.pop("conditions")))
    assert free.conditions == Conditions() == load_settings().conditions
