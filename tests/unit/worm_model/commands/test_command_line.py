# SPDX-License-Identifier: Apache-2.0
import io
import sys

from waiting import wait_for

from worm_model.commands.command_line import ProgressLine, elapsed


def test_progress_shows_the_time_left_at_the_mean_speed(capsys):
    times = iter((100.0, 130.0, 160.0, 200.0))
    line = ProgressLine("study", lambda: next(times))
    for fraction in (0.2, 0.35, 0.6, 1.0):
        line(fraction)
    # 0.15 in 30 s leave 0.65 in 130 s; 0.4 in 60 s leave 0.4 in 60 s.
    assert capsys.readouterr().err == (
        "study: 20%\nstudy: 35%, 2.2 min left\nstudy: 60%, 60 s left\nstudy: 100%\n"
    )


def test_a_long_computation_writes_the_time_so_far_to_standard_error(monkeypatch) -> None:
    written = io.StringIO()
    monkeypatch.setattr(sys, "stderr", written)
    with elapsed("front", every_s=0.001):
        wait_for(written.getvalue)
    text = written.getvalue()
    assert text.startswith("front: ")
    with elapsed("front", every_s=60.0):
        pass
    assert written.getvalue() == text
