# SPDX-License-Identifier: Apache-2.0
"""The bags that come with the project."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from worm_model.analysis.replay_metrics import report_replay
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import namespace_of, read_run
from worm_model.parameters import PAPER
from worm_model.run import POWER_VALID, Activity
from worm_model.twin.offline_replay import replay_run

BAGS = Path(__file__).resolve().parents[4] / "bags"
NAMES = ("forward", "reverse", "faults", "killed")


@pytest.mark.parametrize("name", NAMES[:3])
def test_independent_readers_read_them(name: str):
    bag = BAGS / name
    with AnyReader([bag]) as reader:  # checks the type hashes, too
        count = reader.message_count
        assert sum(1 for c, _, d in reader.messages() if reader.deserialize(d, c.msgtype)) == count
    decoded = 0
    for file in bag.glob("*.mcap"):
        with file.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            decoded += sum(1 for _ in reader.iter_decoded_messages())
    assert decoded == count
    with open_bag(bag) as own:
        assert sum(1 for _ in own.messages()) == count


@pytest.mark.parametrize("name", NAMES)
def test_the_twin_follows_them(name: str):
    with open_bag(BAGS / name, lambda _: None) as opened:
        assert namespace_of(opened) == "/worm"
        assert opened.metadata["worm_run"]["note.made_by"] == f"bags/make.py {name}"
        assert float(opened.metadata["worm_gait"]["stroke"]) > 0.05
        run = read_run(opened)
    report = report_replay(run, replay_run(run, PAPER), PAPER.pitch)
    assert report.residuals.x1_rmse < 1e-3
    assert report.residuals.power_rmse < 1.0
    assert abs(report.energy_error) < 0.05
    whole = [cycle for cycle in report.cycles[1:] if cycle.complete]
    assert [round(cycle.measured_grooves) for cycle in whole] == [cycle.grooves for cycle in whole]
    direction = run.gait_state.direction[run.gait_state.state == Activity.RUNNING][-1]
    complete = [cycle for cycle in report.cycles if cycle.complete]
    assert complete
    assert all(cycle.grooves * direction > 0 for cycle in complete)


def test_power_that_was_not_measured_is_nan():
    with open_bag(BAGS / "faults") as opened:
        power = read_run(opened).power
    failed = power.status > 2  # a bus error, and a sensor that lost its settings
    assert failed.any()
    assert np.isnan(power.power[power.status != POWER_VALID]).all()
    assert np.isfinite(power.power[power.status == POWER_VALID]).all()
