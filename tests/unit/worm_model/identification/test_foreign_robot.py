# SPDX-License-Identifier: Apache-2.0
"""Identification of a robot that the model does not contain."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from foreign_robot import Camera, ForeignRobot, crawl, some_robot
from lab_files import write_foreign_lab
from recorded_run import exact_run
from virtual_campaign import recording_of

from worm_model.analysis.run_metrics import measure_margin
from worm_model.commands import identify
from worm_model.gait import Gait
from worm_model.identification.data.strides import check_pitch, uneven_pitch
from worm_model.identification.fit_verdict import fit_contractions
from worm_model.identification.fits.measured_length import measured_length
from worm_model.identification.fits.quality import follows_command, usable
from worm_model.identification.held_out import compared_margin, recorded_margin
from worm_model.identification.run_selection import fitted_runs
from worm_model.margin.half_cycles import Fin
from worm_model.parameters import PAPER, load_parameter_file

ROBOT = ForeignRobot(pipe=3)
PLAN = ((Gait(0.07, 0.15), 6), (Gait(0.08, 0.18), 4), (Gait(0.08, 0.24), 5), (Gait(0.09, 0.15), 4))
GAITS = (Gait(0.06, 0.08), Gait(0.07, 0.15), Gait(0.08, 0.24))


@pytest.fixture(scope="module")
def runs():
    return [crawl(ROBOT, gait, 4, seed=k) for k, gait in enumerate(GAITS)]


@pytest.fixture(scope="module")
def recordings(runs):
    return [recording_of(run.run, f"run_{k}") for k, run in enumerate(runs)]


@pytest.fixture(scope="module")
def lengths(recordings):
    return [measured_length(recording) for recording in recordings]


def test_the_margin_for_the_travel_error_is_that_of_the_worst_cycle_of_a_run(runs, recordings):
    for run, fitted in zip(runs, fitted_runs(recordings, ROBOT.pitch)[0], strict=True):
        whole, margin = measure_margin(run.run, PAPER), recorded_margin(fitted.recording, PAPER)
        assert margin.grooves == whole.grooves
        expected = whole.margins(Fin.REAR)[0]
        assert margin.margins(Fin.REAR)[0] == pytest.approx(expected, abs=0.0005)
        cycles = np.concatenate([margin.margins(fin)[0] for fin in Fin])
        assert compared_margin(fitted, PAPER)[0] == cycles.min() < margin.least.expected


def test_the_measured_length_is_that_of_the_body(runs, lengths):
    for run, length in zip(runs, lengths, strict=True):
        body = np.interp(length.time, run.time, run.front - run.rear)
        error = length.initial_length + length.length_change - body
        assert np.sqrt(np.mean(error**2)) < 3e-4
        assert not length.explained


def test_a_compliant_cable_is_no_stuck_servo_but_a_slip_and_a_stop_are_found(recordings, lengths):
    assert usable(recordings, lengths) == ([0, 1, 2], [])
    found = recordings[1]
    since = found.camera_time > 2.4 * found.gait.period
    held = found.x1 + found.length[np.flatnonzero(since)[0]]
    for x2, cause in (
        (found.x2 + 0.004 * since, "slipped cable"),
        (found.x2 + 0.05 * since, "slipped cable"),
        (np.where(since, held, found.x2), "stuck servo"),
    ):
        spoilt = replace(found, x2=x2)
        assert cause in follows_command(spoilt, measured_length(spoilt))


def test_the_extensions_show_a_cable_that_cannot_push_and_the_contractions_the_delay(recordings):
    offset, lacking = fit_contractions(recordings)
    assert lacking[2] > 3e-3
    assert np.all(np.diff(lacking) > 0.0)  # with the frequency
    late = -offset  # the servo's delay and lag, and the backlash in slow gaits
    assert np.all((ROBOT.delay_s < late) & (late < ROBOT.delay_s + ROBOT.lag_s + 0.02))
    rigid = [recording_of(exact_run(gait), "rigid") for gait in GAITS]
    assert np.abs(fit_contractions(rigid)[1]).max() < 5e-4


def test_an_uneven_pitch_shows_in_the_strides_and_is_no_wrong_pitch(recordings):
    uneven = uneven_pitch(recordings, ROBOT.pitch)
    assert uneven == pytest.approx(ROBOT.pitch_scatter * ROBOT.pitch, rel=0.6)
    rigid = [recording_of(exact_run(gait, duration=40.0), "rigid") for gait in GAITS]
    assert uneven_pitch(rigid, 0.0173) < 5e-5
    for off in (0.985, 1.015):
        check_pitch(recordings, off * ROBOT.pitch, 2.5e-5)


@pytest.mark.night
def test_a_foreign_lab_gets_a_file_a_report_and_a_verdict(tmp_path, capsys, monkeypatch):
    lab = write_foreign_lab(tmp_path / "lab", some_robot(1), Camera(), PLAN)
    file, report = tmp_path / "robot.yaml", tmp_path / "report"
    outputs = ["--json", "--output", str(file), "--report", str(report)]
    monkeypatch.setattr("sys.argv", ["identify", str(lab), *outputs])
    assert identify.main() == 0
    found = json.loads(capsys.readouterr().out)
    assert found["fit"]["verdict"] in {"roughly", "does_not_fit"}
    causes = " ".join(found["fit"]["causes"])
    for cause in ("cannot push", "delay", "pitch is uneven"):
        assert cause in causes
    assert len(found["runs"]) == len(PLAN)
    assert found["fit"]["inflation"] > 3.0
    assert load_parameter_file(file).intervals["bellows_stiffness"]
    travel_error = load_parameter_file(file).travel_error
    assert travel_error is not None
    assert found["travel_error"] == asdict(travel_error)
    assert abs(travel_error.value) < 0.003
    assert "cannot push" in (report / "report.md").read_text()
