# SPDX-License-Identifier: Apache-2.0
"""The virtual robot on a test bench: identification finds its stiffnesses."""

from dataclasses import replace
from pathlib import Path

import pytest

from worm_driver.commands import bench_tests
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.identification import bellows, fin
from worm_model.identification.inputs import read_bench_test


def test_the_files_hold_what_is_true_of_the_robot_and_are_not_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture
):
    assert bench_tests.main([str(tmp_path), "--seed", "3"]) == 0
    truth = replace(load_settings(), seed=3).true_body
    stiffness = bellows.fit_bellows(*columns(tmp_path / "bellows.csv", bellows.COLUMNS)).stiffness
    assert stiffness.value == pytest.approx(truth.bellows_stiffness, rel=0.02)
    fitted = fin.fit_fin(*columns(tmp_path / "fin.csv", fin.COLUMNS))
    assert fitted.engaged_stiffness.value == pytest.approx(truth.engaged_stiffness, rel=0.05)
    assert bench_tests.main([str(tmp_path)]) == 2
    assert "exists already" in capsys.readouterr().err


def columns(path: Path, names: tuple[str, str]):
    test = read_bench_test(path, names)
    return test.x, test.y
