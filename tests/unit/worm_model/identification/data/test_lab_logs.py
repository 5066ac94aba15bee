# SPDX-License-Identifier: Apache-2.0
"""Valid and invalid logs of a lab."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from lab_files import write_table

from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import namespace_of, read_run
from worm_model.commands import import_lab
from worm_model.errors import IdentificationError
from worm_model.gait import named_values
from worm_model.identification.data.lab_logs import LabSettings, read_lab_run
from worm_model.parameters import PAPER
from worm_model.run import POWER_VALID, Activity
from worm_model.simulation.actuation import resting_change
from worm_msgs.gait import GAIT_COLUMNS, Gait, Profile

EPOCH = 1_767_225_600 * 10**9
SETTINGS = LabSettings(epoch=EPOCH)
CAMERA = "time_s,x1_m,x2_m\n0.1,0.0,0.295\n1.0,,0.296\n1.5,0.0,0.297\n2.5,0.001,0.280\n3.0,0.002,\n"
POWER = "time_s,bus_voltage_V,current_A\n0.0,12.0,0.1\n0.5,11.5,\n1.0,11.0,0.2\n"
SERVO = "time_s,goal_ticks\n0.0,0\n2.5,1024\n4.5,-2048\n"
PLAIN = Gait(0.07, 0.5)
GAITS = {"run_07": {"stroke_m": 0.07, "frequency_Hz": 0.5}}
GAITS_TEXT = json.dumps(GAITS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run = tmp_path / "run_07"
    run.mkdir()
    for name, text in (("camera", CAMERA), ("power", POWER), ("servo", SERVO)):
        (run / f"{name}.csv").write_text(text)
    (tmp_path / "runs.json").write_text(json.dumps(GAITS))
    return run


def seconds(stamp) -> list[float]:
    return ((stamp - EPOCH) / 1e9).tolist()


def test_logs_become_the_series_of_a_run(folder: Path):
    """A quarter turn of a 12 mm spool winds up 2π·12/4 mm of cable; the body rests at 0.296 m before 2 s."""
    lab = read_lab_run(folder, SETTINGS)
    run, quarter = lab.run, 2 * math.pi * 0.012 / 4
    np.testing.assert_allclose(run.commanded.length_change, [0.0, -quarter, 2 * quarter])
    np.testing.assert_allclose(run.commanded.length, 0.296 + run.commanded.length_change)
    assert seconds(run.commanded.stamp) == [0.0, 2.5, 4.5]
    assert np.isnan(run.tracker.rear_position).tolist() == [False, True, False, False, False]
    assert np.isnan(run.tracker.front_position).tolist() == [False, False, False, False, True]
    assert seconds(run.measured.stamp) == [0.1, 1.5, 2.5]
    np.testing.assert_allclose(run.measured.length, [0.295, 0.297, 0.279])
    assert (run.power.status == POWER_VALID).tolist() == [True, False, True]
    np.testing.assert_allclose(run.power.power, [1.2, math.nan, 2.2])
    states = run.gait_state  # at rest, and at each cycle's start: at 2.0 s and, at 0.5 Hz, 4.0 s
    assert seconds(states.stamp) == [0.0, 2.0, 4.0]
    assert states.state.tolist() == [Activity.RESTING, Activity.RUNNING, Activity.RUNNING]
    assert states.onset.tolist() == [0, EPOCH + 2 * 10**9, EPOCH + 2 * 10**9]
    assert states.cycle.tolist() == [0, 1, 2]
    assert (states.stroke == 0.07).all()
    assert lab.initial_length == pytest.approx(0.296)


def test_a_length_that_is_given_counts_and_a_missing_camera_or_gait_is_not_invented(folder: Path):
    given = LabSettings(epoch=EPOCH, initial_length=0.3)
    assert read_lab_run(folder, given).initial_length == 0.3
    (folder / "camera.csv").unlink()
    (folder.parent / "runs.json").unlink()
    lab = read_lab_run(folder, SETTINGS)
    assert lab.initial_length == PAPER.initial_length
    assert (lab.gait, lab.run.tracker.stamp.size, lab.run.gait_state.stamp.size) == (None, 0, 0)
    assert set(lab.checksums) == {"power.csv", "servo.csv"}


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("camera.csv", "", "no column time_s"),
        ("camera.csv", "time_s,x1_m\n0,0\n", "no column x2_m"),
        ("camera.csv", "time_s,x1_m,x2_m\n", "no rows"),
        ("camera.csv", "time_s,x1_m,x2_m\n0,a,1\n", "line 2: x1_m is 'a', not a number"),
        ("camera.csv", "time_s,x1_m,x2_m\n0,0,1\n0,0,1\n", "line 3: time_s does not rise"),
        ("camera.csv", "time_s,x1_m,x2_m\n0,0,1\n1,0\n", "line 3: x2_m is missing"),
        (
            "power.csv",
            "time_s,bus_voltage_V,current_A\n0,1e999,0\n",
            "line 2: bus_voltage_V is inf;",
        ),
        ("power.csv", "time_s,bus_voltage_V,current_A\n0,1,-1e200\n", "current_A is -1e+200;"),
        ("servo.csv", "\x00\x01", "servo.csv"),
        ("../runs.json", "{}", "lacks 'run_07'"),
        ("../runs.json", '{"run_07": {"stroke_m": 1}}', "lacks 'frequency_Hz'"),
        ("../runs.json", '{"run_07": {"stroke_m": -1, "frequency_Hz": 1}}', "run_07 is invalid"),
        ("../runs.json", "[", "not a list of gaits"),
        ("../runs.json", '{"run_07": 3}', "not a list of gaits"),
        ("../runs.json", GAITS_TEXT.replace("0.07", "1" + 400 * "0"), "runs.json"),
        ("../runs.json", GAITS_TEXT.replace("0.5", "1e300"), "runs.json"),
        ("power.csv", POWER.replace("\n0.0,", "\n-5e9,"), "power.csv from -5000000000 to 1 s"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(folder: Path, file: str, text: str, message: str):
    (folder / file).write_text(text)
    with pytest.raises(IdentificationError) as error:
        read_lab_run(folder, SETTINGS)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_with_a_byte_order_mark_and_spaces_is_read(folder: Path):
    (folder / "servo.csv").write_text("\ufefftime_s, goal_ticks\r\n0.0, 0\r\n1.0, 5\r\n")
    assert len(read_lab_run(folder, SETTINGS).run.commanded.stamp) == 2


def test_an_imported_bag_holds_what_the_logs_hold(folder: Path, tmp_path: Path, run):
    status, out, _ = run(import_lab, folder, "--output", tmp_path / "bag", "--json")
    assert (status, json.loads(out)["occluded"]) == (0, 2)  # x1 hidden once, x2 once
    assert run(import_lab, folder, "--output", tmp_path / "again" / "bag")[0] == 2
    (tmp_path / "again").mkdir()
    assert run(import_lab, folder, "--output", tmp_path / "again" / "bag")[0] == 0
    one, other = (
        (path / "bag" / "bag_0.mcap").read_bytes() for path in (tmp_path, tmp_path / "again")
    )
    assert one == other
    expected = read_lab_run(folder, SETTINGS).run
    with open_bag(tmp_path / "bag") as bag:
        assert namespace_of(bag) == "/worm"
        assert bag.metadata["worm_run"]["imported_from"] == "run_07"
        found = read_run(bag)
    for series in ("commanded", "measured", "tracker", "power", "gait_state"):
        for name, values in vars(getattr(expected, series)).items():
            np.testing.assert_array_equal(getattr(getattr(found, series), name), values)
    assert found.origin == expected.origin


def shifted(folder: Path, seconds: float) -> Path:
    """Return a run's folder whose times are those of a clock that is ahead by some seconds."""
    for file in folder.glob("*.csv"):
        head, *rows = file.read_text().splitlines()
        moved = [row.split(",", 1) for row in rows]
        lines = [f"{float(time) + seconds!r},{rest}" for time, rest in moved]
        file.write_text("\n".join([head, *lines]))
    return folder


@pytest.mark.parametrize("start", [-7_200, 86_400, 1_600_000_000, 3_900_000_000, 10**11])
def test_times_of_any_clock_give_the_same_run(folder: Path, start: int):
    plain = read_lab_run(folder, LabSettings())
    lab = read_lab_run(shifted(folder, start), LabSettings())
    assert lab.initial_length == plain.initial_length
    assert lab.onset == pytest.approx(plain.onset, abs=20_000)
    for series in ("tracker", "power", "commanded", "gait_state"):
        stamps = [getattr(run, series).stamp for run in (lab.run, plain.run)]
        np.testing.assert_allclose(*stamps, rtol=0.0, atol=20_000)  # ns, of 1e11 s in 64 bits


@pytest.mark.parametrize(
    ("start", "options", "hint"),
    [
        (1_600_000_000, [], "--epoch 0"),
        (0, ["--epoch", "1e11"], "after 2038"),
        (0, ["--epoch=-1"], "before 1970"),
        (2**31 - 2, ["--epoch", "0"], "after 2038"),
        (0, ["--onset", "1e300"], "onset 1e+300"),
        (1_600_000_000, ["--epoch", "0", "--onset", "2"], "onset 2"),
    ],
)
def test_times_without_a_stamp_of_ros_are_one_line(
    folder: Path, tmp_path: Path, run, start: int, options: list[str], hint: str
):
    shifted(folder, start)
    status, _, error = run(import_lab, folder, "--output", tmp_path / "bag", *options)
    (line,) = error.splitlines()
    assert status == 2
    assert hint in line
    assert not (tmp_path / "bag").exists()


def test_bad_input_ends_with_status_2_and_leaves_nothing(folder: Path, tmp_path: Path, run):
    assert run(import_lab, folder, "--output", folder)[0] == 2
    (folder / "power.csv").write_text("x")
    for logs, fact in (
        (folder, "power.csv"),
        (tmp_path, "none of camera"),
        (tmp_path / "no", "no"),
    ):
        status, _, error = run(import_lab, logs, "--output", tmp_path / "bag")
        assert (status, error.count("\n")) == (2, 1)
        assert fact in error
    assert not (tmp_path / "bag").exists()


def played(
    folder: Path, radius: float, onset: float, gait: Gait = PLAIN, tensioned: float = 0.0
) -> Path:
    """Return the servo's log of two cycles of the gait with a spool and an onset; tensioned up to a time (s)."""
    time = np.arange(0.0, onset + 2 * gait.period, 0.02)
    command = np.array([gait.command(max(t - onset, 0.0)) for t in time])
    command *= np.minimum(time / tensioned, 1.0) if tensioned else 1.0
    ticks = np.rint(-command / (2 * math.pi * radius) * 4096)
    write_table(folder / "servo.csv", "time_s,goal_ticks", time, ticks)
    return folder


GAITS_PLAYED = (
    PLAIN,
    Gait(0.07, 0.5, contraction_share=0.7, profile=Profile.TRAPEZOID, ramp_share=0.1),
    Gait(0.06, 0.5, pretension=0.01),
    Gait(0.05, 0.4, pretension=0.015, contraction_share=0.3, profile=Profile.TRAPEZOID),
)


@pytest.mark.parametrize("tensioned", [0.0, 0.8])
@pytest.mark.parametrize("gait", GAITS_PLAYED)
def test_spool_and_onset_are_found(folder: Path, gait: Gait, tensioned: float):
    columns = {GAIT_COLUMNS[name]: value for name, value in named_values(gait).items()}
    (folder.parent / "runs.json").write_text(json.dumps({"run_07": columns}))
    lab = read_lab_run(played(folder, 0.0125, 1.5, gait, tensioned), SETTINGS)
    assert lab.gait == gait
    assert lab.spool_radius == pytest.approx(0.0125, rel=1e-12)
    assert (lab.onset - EPOCH) * 1e-9 == pytest.approx(1.5, abs=0.01)
    assert lab.initial_length == pytest.approx(0.296 - resting_change(gait, PAPER), abs=2e-3)
    assert not any("assumed" in text for text in lab.remarks)


def test_a_given_spool_that_contradicts_the_stroke_is_reported(folder: Path):
    given = LabSettings(epoch=EPOCH, onset=2.0, spool_radius=1.02 * 0.012)
    found = read_lab_run(played(folder, 0.012, 2.0), given)
    assert found.spool_radius == given.spool_radius
    (remark,) = found.remarks
    assert "12.24 mm as given" in remark
    assert "with 12.00 mm" in remark
    right = LabSettings(epoch=EPOCH, onset=2.0, spool_radius=0.012)
    assert read_lab_run(folder, right).remarks == ()
