# SPDX-License-Identifier: Apache-2.0
"""A simulated gait as a table, a figure and a recording."""

import csv
import json

import numpy as np
import pytest
from PIL import Image, ImageSequence

from worm_model.analysis.gait_animation import animated_figure, write_animation
from worm_model.analysis.simulated_run import simulated_run
from worm_model.commands import simulate as command
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait

COLUMNS = (
    "time_s,length_change_m,rear_position_m,front_position_m,rear_anchor_m,front_anchor_m,"
    "cable_force_N,power_W,energy_J"
)


def test_the_table_holds_the_gait_from_its_onset_to_its_end(run, tmp_path):
    path = tmp_path / "gait.csv"
    arguments = ("--stroke", 0.07, "--frequency", 0.2, "--json", "--output", path)
    status, reported, _ = run(command, *arguments)
    assert status == 0
    assert path.read_text().splitlines()[0] == COLUMNS
    rows = np.array(list(csv.reader(path.open()))[1:], float)
    assert rows.shape == (2501, 9)  # five cycles of 5 s at 100 Hz
    assert np.all(rows[0, [0, 1, 2, 8]] == 0.0)
    result = evaluate_gait(Gait(0.07, 0.2))
    assert (rows[-1, 2] - rows[1000, 2]) / 15.0 == pytest.approx(result.speed, rel=1e-9)
    assert (rows[-1, 8] - rows[1000, 8]) / 15.0 == pytest.approx(result.power, rel=1e-9)
    assert json.loads(reported)["speed"] == pytest.approx(result.speed)
    status, _, error = run(command, *arguments)
    assert status == 2
    assert "exists already" in error


def test_a_period_that_is_no_multiple_of_the_step_does_not_run_over_the_end(run, tmp_path):
    path = tmp_path / "gait.csv"
    arguments = ("--stroke", 0.07, "--frequency", 0.3, "--cycles", 1, "--rate", 7, "--output", path)
    assert run(command, *arguments)[0] == 0
    times = np.array([row.split(",")[0] for row in path.read_text().splitlines()[1:]], float)
    assert times == pytest.approx(np.arange(24) / 7.0)


def test_an_animation_plays_in_real_time(run, tmp_path):
    path = tmp_path / "gait.gif"
    arguments = (
        "--stroke",
        0.07,
        "--frequency",
        0.4,
        "--cycles",
        1,
        "--rate",
        10,
        "--output",
        path,
    )
    assert run(command, *arguments)[0] == 0
    with Image.open(path) as animation:
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(animation)]
        assert animation.n_frames == 26  # one cycle of 2.5 s at 10 Hz, with both ends
        assert animation.info["duration"] == 100  # ms
    # The fins hold (green) and yield (amber) within the pipe, below the legend.
    for name, colour in (("holds", (26, 179, 51)), ("yields", (242, 153, 26))):
        shown = [
            np.any(np.abs(np.asarray(frame)[40:220].astype(int) - colour).max(axis=2) < 8)
            for frame in frames
        ]
        assert any(shown), name
        assert not all(shown), name


def test_an_mp4_without_ffmpeg_is_one_line(run, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    status, _, error = run(
        command, "--stroke", 0.07, "--frequency", 0.2, "--output", tmp_path / "x.mp4"
    )
    assert status == 2
    assert "ffmpeg" in error
    assert error.count("\n") == 1


def test_ffmpeg_receives_every_frame(run, tmp_path, monkeypatch):
    fake = tmp_path / "ffmpeg"
    fake.write_text('#!/bin/sh\nfor last; do :; done\nexec /bin/cat > "$last"\n')
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    path = tmp_path / "x.mp4"
    arguments = ("--stroke", 0.07, "--frequency", 0.4, "--cycles", 1, "--rate", 4, "--output", path)
    assert run(command, *arguments)[0] == 0
    assert path.stat().st_size == 11 * 840 * 480 * 4  # RGBA


def test_an_animation_that_is_cancelled_leaves_no_file(tmp_path):
    def cancel(_fraction):
        raise KeyboardInterrupt

    simulated = simulated_run(Gait(0.07, 0.4), PAPER, 1, 10.0)
    with pytest.raises(KeyboardInterrupt):
        write_animation(simulated, tmp_path / "x.gif", cancel)
    assert list(tmp_path.iterdir()) == []


def test_the_view_follows_a_robot_that_crawls_far(tmp_path):
    simulated = simulated_run(Gait(0.0755, 0.2), PAPER, 8, 2.0)
    figure, _, show = animated_figure(simulated)
    pipe = figure.axes[0]
    for index in (0, simulated.time.size // 2, simulated.time.size - 1):
        show(index)
        low, high = pipe.get_xlim()
        assert low < 1e3 * simulated.motions.x1[index]
        assert 1e3 * simulated.motions.x2[index] < high
    assert simulated.motions.x1[-1] > 0.2
