# SPDX-License-Identifier: Apache-2.0
"""Reports of recorded gaits."""

import dataclasses
import functools
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from gaits_for_tests import COARSE
from recorded_run import GAIT, simulated_run, write_bag
from unrendered import leave_runs_unrendered
from virtual_session import joined_session

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.stored_file import AttachedFile
from worm_model.bags.run_writer import write_run
from worm_model.commands.command_line import InputError
from worm_model.gait import Gait
from worm_model.parameters import PAPER, ParameterFile, format_parameter_file
from worm_model.run import GaitStates, Run, TrackerSamples
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.robot_parameters import TravelError
from worm_optimizer.commands import report as command
from worm_optimizer.report import agreement
from worm_optimizer.report.expectation import Band, GrooveShare, expect
from worm_optimizer.report.optimisation import optimise, why_no_front
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.report.recordings import bags_of, newest_recording, read_recorded_gaits
from worm_optimizer.report.report_page import Report, build_report
from worm_optimizer.search.search_settings import ScanSettings, Settings

CYCLES = 5
EDGE = Gait(0.07, 0.2)  # its grooves depend on the switching threshold


def silent(line: str) -> None:
    raise AssertionError(line)


@pytest.fixture(scope="module")
def gait(tmp_path_factory: pytest.TempPathFactory) -> RecordedGait:
    folder = tmp_path_factory.mktemp("bags")
    return read_one(write_bag(folder / "five", simulated_run(CYCLES)), measured_model(folder))


@pytest.fixture
def unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do not render the figures of single gaits. The tests of the page and without a tracker render them."""
    leave_runs_unrendered(monkeypatch)


def measured_model(folder: Path) -> str:
    """Write the paper's parameters, with a travel error that runs have measured, and return the path."""
    path = folder / "measured.yaml"
    path.write_text("travel_error: {value: 0.0, sd: 0.0002}\n")
    return str(path)


def read_one(bag: Path, parameters: str = "") -> RecordedGait:
    [gait] = read_recorded_gaits([bag], parameters, silent)
    return gait


def read(path: Path, run: Run, parameters: str = "") -> RecordedGait:
    return read_one(write_bag(path, run), parameters)


def with_speed(gait: RecordedGait, name: str, measured: float, expected: float) -> RecordedGait:
    """Return a gait with another name and other speeds."""
    band = Band(expected, 0.9 * expected, 1.1 * expected)
    return dataclasses.replace(
        gait,
        name=name,
        measured=dataclasses.replace(gait.measured, speed=Band(measured, measured, measured)),
        expected=dataclasses.replace(
            gait.expected, bands=dataclasses.replace(gait.expected.bands, speed=band)
        ),
    )


# --- content of a recording ----------------------------------------------------------------------


def test_the_twin_follows_and_the_expectation_holds(gait: RecordedGait):
    assert gait.twin.speed.value == pytest.approx(gait.measured.speed.value, rel=0.02)
    assert gait.expected.nominal == evaluate_gait(GAIT)
    assert all(row.agrees for row in agreement.agreements(gait))
    assert "measured travel error" in gait.expected.condition
    assert gait.missing == ()
    assert gait.judged.cycles[-1].measured_grooves == pytest.approx(
        gait.expected.nominal.grooves_per_cycle, abs=0.05
    )


def test_a_recording_that_ends_early_is_averaged_over_its_last_whole_cycles(tmp_path: Path):
    run = simulated_run(4)
    states = dataclasses.replace(run.gait_state, cycles=np.full(run.gait_state.stamp.size, 9))
    gait = read(tmp_path / "early", dataclasses.replace(run, gait_state=states))
    assert gait.played.cycles == 9
    assert gait.averaged_cycles == (2, 4)
    assert gait.early_end == "ended (idle) after 4 of 9 cycles"
    assert gait.measured.speed.value == pytest.approx(evaluate_gait(GAIT).speed, rel=0.02)


@pytest.mark.parametrize("cycles", [1, 3, 4, 5])
def test_a_short_run_is_held_against_the_same_cycles_of_the_model(tmp_path: Path, cycles: int):
    """Its first cycles begin with straight fins and gain other grooves than the later ones."""
    gait = read(tmp_path / "short", simulated_run(cycles), measured_model(tmp_path))
    assert gait.averaged_cycles == (max(cycles - 2, 1), cycles)
    assert gait.expected.nominal == evaluate_gait(GAIT, PAPER, cycles, min(cycles, 3))
    assert gait.measured.speed.value == pytest.approx(gait.expected.nominal.speed, rel=0.01)
    assert gait.measured.power.value == pytest.approx(gait.expected.nominal.power, rel=0.01)
    steady = cycles > 3  # with fewer, there is nothing to compare
    assert {row.agrees for row in agreement.agreements(gait)} == {True if steady else None}
    assert (agreement.TOO_SHORT in agreement.describe([gait])) != steady
    assert math.isnan(agreement.agreements(gait)[0].difference) != steady
    assert gait.early_end == ""


@pytest.mark.usefixtures("unrendered")
def test_a_fault_is_reported_first_and_standing_still_is_not_averaged(tmp_path: Path):
    """The recording continues after the fault; only the played part counts."""
    run = simulated_run(CYCLES)
    states, onset = run.gait_state, int(run.gait_state.onset[1])
    row = int(np.flatnonzero(states.cycle == 4)[0])
    kept = {name: values[: row + 1].copy() for name, values in vars(states).items()}
    kept["state"][row] = 5
    kept["stamp"][row] = onset + round(3.4e9 * GAIT.period)
    kept["cycles"][:] = CYCLES
    gait = read(tmp_path / "fault", dataclasses.replace(run, gait_state=GaitStates(**kept)))
    assert gait.averaged_cycles == (1, 3)
    assert gait.early_end.startswith("ended in FAULT after 3 of 5 cycles")
    assert agreement.headline([gait]).startswith("fault ended in FAULT after 3 of 5 cycles")
    assert agreement.describe([gait]).startswith("fault: ended in FAULT")
    page = build_report(Report("fault", [gait]), tmp_path / "report").read_text()
    assert page.index("ended in FAULT") < page.index("<nav")


def test_without_a_tracker_power_is_reported_and_the_reason_of_the_rest(tmp_path: Path):
    run = dataclasses.replace(simulated_run(CYCLES), tracker=TrackerSamples())
    gait = read(tmp_path / "blind", run)
    assert math.isnan(gait.measured.speed.value)
    assert math.isnan(gait.measured.cost_of_transport.value)
    assert gait.measured.power.value == pytest.approx(evaluate_gait(GAIT).power, rel=0.01)
    assert gait.missing == ("the recording has no position of x1 over the averaged cycles",)
    assert [row.agrees for row in agreement.agreements(gait)] == [None, True, None]
    build_report(Report("blind", [gait]), tmp_path / "report")


def write_bag_with(path: Path, run: Run, **parameters: float) -> None:
    """Write a run with a file of these parameters inside."""
    text = format_parameter_file(ParameterFile(PAPER.replace(**parameters))).encode()
    with new_bag(path) as writer:
        writer.add_attachment(AttachedFile("parameters.yaml", "application/yaml", text))
        write_run(writer, run)


def test_the_parameter_file_inside_the_recording_counts(tmp_path: Path):
    write_bag_with(tmp_path / "own", simulated_run(CYCLES), idle_power=1.25)
    gait = read_one(tmp_path / "own")
    assert gait.content.parameters.idle_power == 1.25
    assert gait.parameter_source == "the parameter file inside the recording"
    (tmp_path / "given.yaml").write_text("idle_power: 0.5\n")
    given = read_one(tmp_path / "own", str(tmp_path / "given.yaml"))
    assert given.content.parameters.idle_power == 0.5


def test_powers_of_two_forms_are_not_compared(tmp_path: Path):
    bags = [tmp_path / "pulls", tmp_path / "pushes"]
    for bag, form in zip(bags, (True, False), strict=True):
        write_bag_with(bag, simulated_run(1), one_sided_cable=form)
    with pytest.raises(InputError, match="pulls was recorded with parameters of a cable that"):
        read_recorded_gaits(bags, "", silent)
    gait = read_one(bags[0])
    assert gait.parameter_source.endswith("(a cable that cannot push)")
    assert gait.expected.nominal == evaluate_gait(
        GAIT, PAPER.replace(one_sided_cable=True), *(gait.played.cycles,) * 2
    )


def test_events_contain_states_and_gaps(gait: RecordedGait):
    texts = [event.text for event in gait.events]
    assert "running" in texts
    assert any("rear marker hidden in 4 of" in text for text in texts)
    times = [event.time for event in gait.events if math.isfinite(event.time)]
    assert times == sorted(times)


# --- several gaits in one recording ---------------------------------------------------------------


def test_each_gait_of_a_recording_is_reported_with_a_message(tmp_path: Path):
    """The twin goes on from one gait to the next."""
    bag = write_bag(tmp_path / "two", joined_session())
    reported: list[str] = []
    gaits = read_recorded_gaits([bag], "", reported.append)
    assert [(gait.name, gait.played.cycles) for gait in gaits] == [("two_1", 4), ("two_2", CYCLES)]
    assert len(reported) == 1
    assert "2 gaits" in reported[0]
    for gait in gaits:
        assert gait.missing == ()
        assert gait.measured.speed.value == pytest.approx(evaluate_gait(GAIT).speed, rel=0.02)
        assert len(gait.judged.cycles) == gait.played.cycles
        assert [event.text for event in gait.events].count("running") == 1
        assert all(event.time >= 0.0 for event in gait.events if math.isfinite(event.time))
        assert gait.judged.residuals.x1_rmse < 1e-3
        assert gait.judged.cycles[0].grooves == round(gait.judged.cycles[0].measured_grooves)


# --- expectations ---------------------------------------------------------------------------------


def test_a_known_correlation_of_damping_and_power_factor_narrows_the_band_of_power():
    # 2.7 and 2.1 % to either side, correlated with −0.97: estimated from the lab's eight runs
    intervals = {key: (value, value) for key, value in PAPER.as_dict().items()}
    intervals |= {"bellows_damping": (839.1, 885.7), "power_factor": (3.152, 3.288)}

    def width(correlations) -> float:
        content = ParameterFile(PAPER, intervals, correlations=correlations)
        power = expect(GAIT, content).bands.power
        return (power.high - power.low) / power.value

    free, known = width({}), width({("bellows_damping", "power_factor"): -0.97})
    assert 0.03 < free < 0.06
    assert known < 0.45 * free


def test_intervals_hold_the_prediction_and_are_the_same_each_time():
    first, second = expect(GAIT, ParameterFile()), expect(GAIT, ParameterFile())
    assert first == second
    for band in dataclasses.astuple(first.bands):
        value, low, high = band
        assert low <= value <= high


# --- several gaits --------------------------------------------------------------------------------


def test_order_is_preserved_or_not_or_uncertain(gait: RecordedGait):
    slow, fast = with_speed(gait, "slow", 1.0, 1.1), with_speed(gait, "fast", 2.0, 1.9)
    assert agreement.orders([gait]) == {}
    assert agreement.orders([fast, slow])["speed"][0] is True
    assert agreement.orders([slow, with_speed(gait, "fast", 0.5, 1.9)])["speed"][0] is False
    for measured, expected in ((math.nan, 1.9), (2.0, math.nan), (1.0, 1.9), (2.0, 1.1)):
        other = with_speed(gait, "fast", measured, expected)
        for pair in ([slow, other], [other, slow]):
            preserved, text = agreement.orders(pair)["speed"]
            assert preserved is None
            assert agreement.agreement_json(pair)["order_preserved"]["speed"] is None
            assert "unknown" in text


def test_nothing_that_is_twenty_percent_off_agrees():
    """Regardless of the width of the interval."""
    for measured, agrees in ((1.0, True), (1.19, True), (1.21, False), (0.79, False)):
        band = Band(measured, measured, measured)
        assert agreement.Agreement("wide", "power", band, Band(1.0, 0.1, 9.0)).agrees is agrees


@pytest.mark.parametrize(
    ("shares", "measured", "agrees", "verdict"),
    [
        (((2.0, 1.0),), 2.0, True, "agrees"),
        (((2.0, 0.97), (1.0, 0.03)), 2.01, True, "agrees"),
        (((2.0, 0.97), (1.0, 0.03)), 1.67, False, "disagrees"),
        (((2.0, 0.97), (1.0, 0.03)), 1.0, False, "disagrees"),
        (
            ((2.0, 0.71), (1.0, 0.29)),
            5 / 3,
            None,
            "fragile: 2 grooves with 71 %, 1 with 29 %; measured 1.67",
        ),
        (
            ((1.0, 0.6), (2.0, 0.4)),
            1.5,
            None,
            "fragile: 1 groove with 60 %, 2 with 40 %; measured 1.5",
        ),
        (((2.0, 0.6), (1.0, 0.4)), 3.0, False, "disagrees"),
        (((2.0, 0.71), (1.0, 0.27), (4.0, 0.02)), 4.0, False, "disagrees"),
    ],
)
def test_a_speed_is_whole_grooves_and_its_verdict_can_fail(shares, measured, agrees, verdict):
    expected = tuple(GrooveShare(*share) for share in shares)
    grooves = agreement.Grooves(expected, measured, 3)
    band = Band(measured, measured, measured)
    row = agreement.Agreement("gait", "speed", band, Band(2.0, 0.0, 9.0), grooves)
    assert (row.agrees, row.verdict) == (agrees, verdict)


def test_power_is_expected_for_the_grooves_that_were_measured():
    """The gait is on the edge between one groove and two, which depends on an uncertain threshold."""
    intervals = {"switching_threshold": (0.0165, 0.0185)}
    content = ParameterFile(PAPER, intervals, travel_error=TravelError(0.0, 0.0))
    found = {
        measured: expect(EDGE, content, measured_grooves=measured) for measured in (1.0, 4 / 3, 2.0)
    }
    shares = found[1.0].grooves
    assert {share.grooves for share in shares} >= {1.0, 2.0}
    assert sum(share.probability for share in shares) == pytest.approx(1.0)
    assert [share.probability for share in shares] == sorted(
        (share.probability for share in shares), reverse=True
    )
    one, between, two = (found[measured].bands.power for measured in (1.0, 4 / 3, 2.0))
    assert one.low < one.value < one.high
    assert one.value < between.value < two.value
    assert math.isnan(expect(EDGE, content, measured_grooves=9.0).bands.power.value)


# --- the front of the gaits -----------------------------------------------------------------------


def made_with(gait: RecordedGait, margin: float, direction: int = 1) -> RecordedGait:
    played = dataclasses.replace(gait.gait, margin=margin, direction=direction)
    return dataclasses.replace(gait, played=dataclasses.replace(gait.played, gait=played))


@pytest.mark.usefixtures("unrendered")
def test_gaits_of_different_margins_get_the_cliffs_which_the_page_reports(
    gait: RecordedGait, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    quick = functools.partial(
        Settings, scan=ScanSettings(0.003, 0.004, 0.0002), resolution=COARSE, samples=20
    )
    monkeypatch.setattr("worm_optimizer.report.optimisation.Settings", quick)
    gaits = [made_with(gait, 0.002), made_with(gait, 0.003)]
    found = optimise(gaits)
    assert found.front.margin == found.price.margin == pytest.approx(0.0034)
    alone = optimise([made_with(gait, 0.0034)]).front
    assert (alone.reason, alone.three) == (found.front.reason, found.front.three)
    page = build_report(Report("mixed", gaits, found), tmp_path / "report").read_text()
    assert "margins from 2.00 to 3.00 mm" in page


@pytest.mark.usefixtures("unrendered")
def test_gaits_without_a_front_in_common_are_shown_without(gait: RecordedGait, tmp_path: Path):
    assert why_no_front([gait, made_with(gait, 0.002)]) == ""
    back = made_with(gait, 0.0, direction=-1)
    assert "different directions" in why_no_front([gait, back])
    heavy = dataclasses.replace(gait, content=ParameterFile(PAPER.replace(rear_mass=0.5)))
    assert "different parameters" in why_no_front([gait, heavy])
    report = Report("mixed", [gait, back], note=why_no_front([gait, back]))
    assert "different directions" in build_report(report, tmp_path / "report").read_text()


# --- the page -------------------------------------------------------------------------------------


def test_the_page_needs_nothing_else_and_figures_are_next_to_it(gait: RecordedGait, tmp_path: Path):
    special = dataclasses.replace(gait, name="<b>odd & name</b>")
    page = build_report(Report("A <title>", [special]), tmp_path / "report")
    text = page.read_text(encoding="utf-8")
    sources = re.findall(r'src="([^"]{0,40})', text)
    assert len(sources) == 3
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    anchors = re.findall(r'href="#([^"]+)"', text)
    assert len(anchors) == text.count("href=") == 3
    assert all(f'id="{anchor}"' in text for anchor in anchors)
    assert "<script" not in text
    assert "<b>odd" not in text
    assert "&lt;b&gt;odd &amp; name" in text
    figures = {path.name for path in (page.parent / "figures").iterdir()}
    assert figures == {
        f"run_1_{name}.{kind}" for name in ("motion", "length", "energy") for kind in ("png", "pdf")
    }


@pytest.mark.usefixtures("unrendered")
def test_identified_parameters_are_on_the_page(gait: RecordedGait, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text("gain: 0.9\nintervals: {gain: [0.88, 0.92]}\n")
    report = Report("mine", [gait], identification=str(path))
    text = build_report(report, tmp_path / "page").read_text(encoding="utf-8")
    assert "0.88 to 0.92" in text


# --- the command ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("unrendered")
def test_the_newest_recording_is_reported_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run
):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "bags" / "mine", simulated_run(CYCLES))
    model = measured_model(tmp_path)
    status, out, _ = run(command, "--without-front", "--json", "--parameters", model)
    content = json.loads(out)
    assert status == 0
    assert Path(content["page"]) == tmp_path / "bags" / "mine_report" / "report.html"
    assert Path(content["page"]).is_file()
    assert content["runs"][0]["agrees"] == {"speed": True, "power": True, "cost_of_transport": True}


def test_a_folder_of_bags_stands_for_them_in_the_order_of_their_ends(tmp_path: Path):
    for number, name in enumerate(("second", "first")):
        bag = write_bag(tmp_path / "campaign" / name, simulated_run(2))
        os.utime(bag / "metadata.yaml", (0, 100 - number))
    assert [bag.name for bag in bags_of(tmp_path / "campaign")] == ["first", "second"]
    assert bags_of(bag) == [bag]


def test_the_newest_recording_of_a_gait_is_found(tmp_path: Path):
    """It may be in a campaign; a bag without a gait and a broken one are skipped."""
    run = simulated_run(1)
    rested = GaitStates(**{name: values[:1] for name, values in vars(run.gait_state).items()})
    bags = ("old", "campaign/cruise", "single", "failed", "broken")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").touch()
    for closed, name in enumerate(bags):
        if name != "broken":
            own = dataclasses.replace(run, gait_state=rested) if name == "failed" else run
            write_bag(tmp_path / name, own)
        os.utime(tmp_path / name / "metadata.yaml", (0, closed))
    reported: list[str] = []
    assert newest_recording(tmp_path, reported.append) == tmp_path / "single"
    assert [line.startswith("skipped: ") for line in reported] == [True, True]
    assert str(tmp_path / "broken" / "metadata.yaml") in reported[0]
    assert reported[1].endswith("failed contains no gait")
    os.utime(tmp_path / "campaign/cruise/metadata.yaml", (0, 9))
    assert newest_recording(tmp_path, reported.append) == tmp_path / "campaign"
