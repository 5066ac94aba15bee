# SPDX-License-Identifier: Apache-2.0
"""The virtual robot's file: rejected values, and the facts in the messages."""

import pytest
import yaml

from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE, load_settings
from worm_msgs.conditions import Conditions
from worm_msgs.yaml_file import SettingsFileError


def write(tmp_path, change):
    content = yaml.safe_load(DEFAULT_FILE.read_text())
    change(content)
    path = tmp_path / "robot.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize(
    ("change", "facts"),
    [
        (lambda c: c["body"].update(pich=1), ["body", "'pich'", "pitch"]),
        (lambda c: c["body"].pop("gain"), ["body: gain", "missing"]),
        (lambda c: c["body"].update(pitch=-0.01), ["body: pitch", "-0.01"]),
        (lambda c: c["body"].update(pitch=17.3), ["body: pitch", "17.3", "0.2", "d, m"]),
        (lambda c: c.update(step_s=0.01), ["step_s", "0.001", "0.01"]),
        (lambda c: c["servos"].update(baud_rate=1234), ["servos: baud_rate", "57600", "1234"]),
        (lambda c: c["cable_servos"][0].update(id=11), ["same id"]),
        (lambda c: c["cable_servos"][0].update(id=253), ["cable_servos: [0]: id", "252", "253"]),
        (lambda c: c["cable_servos"][0].update(sign=0), ["cable_servos: [0]: sign", "1 or -1"]),
        (lambda c: c["cable_servos"][0].update(model="XL320"), ["model", "XL330-M288", "'XL320'"]),
        (lambda c: c["fin_servos"][0].update(model="XL330-M288"), ["servo 11", "3.7", "6.0 V"]),
        (lambda c: c["fin_servos"].pop(), ["fin_servos", "rear", "front"]),
        (lambda c: c.update(fin_servos=[]), ["fin_servos", "1 item"]),
        (lambda c: c["conditions"].update(slope_deg=91), ["conditions: slope_deg", "90", "91"]),
    ],
)
def test_invalid_values_are_rejected(tmp_path, change, facts):
    path = write(tmp_path, change)
    with pytest.raises(SettingsFileError) as caught:
        load_settings(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert [fact for fact in facts if fact not in message.removeprefix(str(path))] == []


def test_conditions_in_the_file_load_the_robot(tmp_path):
    stated = {"slope_deg": 20, "tether_n": 2, "tether_n_per_m": 0.5}
    loaded = load_settings(write(tmp_path, lambda c: c.update(conditions=stated)))
    assert loaded.conditions == Conditions(20.0, 2.0, 0.5)
    free = load_settings(write(tmp_path, lambda c: c.pop("conditions")))
    assert free.conditions == Conditions() == load_settings().conditions
