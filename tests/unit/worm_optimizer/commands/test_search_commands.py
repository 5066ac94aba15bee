# SPDX-License-Identifier: Apache-2.0
"""The command lines optimize, scan_margin and request, as scripts use them."""

import contextlib
import io
import json
import re
import sys
from pathlib import Path

import pytest

from worm_optimizer.commands import capability, optimize, request, scan_margin

GAIT_KEYS = set(
    "stroke frequency direction margin speed power cost_of_transport grooves_per_cycle groove_phase "
    "nominal_speed nominal_power success_probability success_probability_any_phase "
    "stroke_to_lower_edge stroke_to_upper_edge".split()
)
QUICK = "--margin 0.0034 --samples 20".split()
ONE = "--frequencies 0.2 0.2".split()  # a front of two gaits, for tests of what is printed
FULL_KEYS = {"success_probability", "success_probability_any_phase"} | {
    f"stroke_to_{edge}_edge" for edge in ("lower", "upper")
}
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def exact() -> dict:
    """Return the output of `optimize` with the settings of QUICK, computed once."""
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out:
        patch.setattr(sys, "argv", ["optimize", *QUICK, "--json"])
        assert optimize.main() == 0
    return json.loads(out.getvalue())


def test_optimize_prints_the_contracts_keys(run):
    status, out, err = run(optimize, *QUICK, "--json")
    reported = json.loads(out)
    assert status == 0
    assert all(line.startswith("front: computing") for line in err.splitlines())
    assert "hypervolume_share" not in reported
    assert all(set(gait) >= GAIT_KEYS - FULL_KEYS for gait in reported["front"])
    assert all(set(reported[name]) >= GAIT_KEYS for name in ("min_power", "cruise", "max_speed"))
    assert reported["verification"]["power_rises"] is True
    assert reported["cruise"]["cost_of_transport"] < 61.5015
    assert reported["min_power"]["power"] == min(gait["power"] for gait in reported["front"])
    assert reported["max_speed"]["speed"] == max(gait["speed"] for gait in reported["front"])
    costs = [gait["cost_of_transport"] for gait in reported["front"]]
    assert reported["cruise"]["cost_of_transport"] == min(costs)
    assert reported["nominal"]["cruise"]["margin"] == 0.0


def test_the_papers_method_is_compared_with_the_exact_front(run, exact):
    small = ["--method", "nsga2", "--population", "20", "--generations", "5"]
    status, out, err = run(optimize, *QUICK, *small, "--json")
    reported = json.loads(out)
    assert status == 0
    assert "NSGA-II" in err
    assert 0.5 < reported["hypervolume_share"] < 1.0
    assert set(reported["missed_branches"]) <= {1.0, 2.0}
    assert reported["largest_excess_power"] > 0.0
    for name in ("min_power", "cruise"):
        assert reported[name]["cost_of_transport"] > exact[name]["cost_of_transport"]
    reported = json.loads(run(optimize, *QUICK, *ONE, *small, "--json")[1])
    share = f"{100.0 * reported['hypervolume_share']:.2f} %"
    excess = f"{100.0 * reported['largest_excess_power']:.2f} %"
    assert share != excess
    text = run(optimize, *QUICK, *ONE, *small)[1]
    assert re.search(rf"^NSGA-II .*{share} .*{excess}", text, re.M)


def test_optimize_keeps_the_limits_of_the_drivers_servos(run, exact):
    driver = Path(__file__).resolve().parents[4] / "src" / "worm_driver" / "config" / "driver.yaml"
    limited = ["--limits-from", str(driver), "--servo-model", "XM430-W350", "--max-power", "9"]
    reported = json.loads(run(optimize, *QUICK, *limited, "--json")[1])
    assert exact["limits"] == {}
    assert reported["limits"]["cable_speed"] == pytest.approx(0.1199, abs=1e-4)
    assert reported["limits"]["electrical_power"] == 9.0
    assert reported["max_speed"]["speed"] < exact["max_speed"]["speed"]
    assert "limits        cable speed 0.12 m/s, " in run(optimize, *QUICK, *ONE, *limited)[1]


def test_scan_margin_prints_the_contracts_keys(run):
    status, out, _ = run(scan_margin, "--lowest", "0.003", "--highest", "0.0036", "--json")
    reported = json.loads(out)
    assert status == 0
    assert reported["margins"] == pytest.approx(
        [0.003, 0.0031, 0.0032, 0.0033, 0.0034, 0.0035, 0.0036]
    )
    assert len(reported["cost_of_transport"]) == 7
    assert reported["cliff_margin"] == pytest.approx(0.003419, abs=1e-6)
    assert reported["chosen_margin"] == 0.0034
    assert reported["lost_branch"] == 2
    assert reported["closed_form_cliff_margin"] == pytest.approx(0.003419, abs=1e-6)
    assert reported["groove_phase"] == pytest.approx(0.0011)


def test_where_nothing_moves_the_cost_is_null(run):
    _, out, _ = run(scan_margin, "--strokes", "0.01", "0.03", "--highest", "0.0001", "--json")
    assert json.loads(out)["cost_of_transport"] == [None, None]


def test_request_prints_a_gait(run):
    status, out, _ = run(request, *QUICK, "--speed", "0.005", "--json")
    gait = json.loads(out)
    assert status == 0
    assert set(gait) >= GAIT_KEYS
    assert gait["speed"] == pytest.approx(0.005, abs=1e-8)
    assert gait["margin"] == 0.0034


def test_an_unreachable_request_is_rejected_with_the_nearest(run):
    status, out, err = run(request, *QUICK, "--power", "0.9", "--json")
    reported = json.loads(out)
    assert status == 2
    assert set(reported) == {"error", "nearest"}
    assert reported["nearest"]["power"] == pytest.approx(1.2544, abs=1e-4)
    assert err.splitlines()[-1] == f"request: {reported['error']}"


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        (optimize, [*QUICK, *ONE]),
        (request, [*QUICK, *ONE]),
        (scan_margin, ["--lowest", "0.003", "--highest", "0.0036"]),
    ],
)
def test_a_figure_is_drawn_once_and_never_over_another_file(run, tmp_path, command, arguments):
    path = tmp_path / "figure.png"
    assert run(command, *arguments, "--figure", str(path))[0] == 0
    drawn = path.read_bytes()
    assert drawn.startswith(PNG)
    status, _, err = run(command, *arguments, "--figure", str(path))
    assert status == 2
    assert "exists already" in err
    assert path.read_bytes() == drawn


def test_optimize_searches_shaped_gaits_under_conditions(run):
    few = "--frequencies", "0.15", "0.15", "--waveform", "shaped", "--slope", "5", "--margin-n", "1"
    reported = json.loads(run(optimize, *few, "--samples", "5", "--json")[1])
    cruise = reported["cruise"]
    assert reported["waveform"] == "shaped"
    assert reported["conditions"]["slope_deg"] == 5.0
    assert reported["margin"] == pytest.approx(1.0 / 2275.1)
    assert cruise["profile"] == "trapezoid"
    assert cruise["stroke"] + cruise["pretension"] <= 0.09 + 1e-12
    assert reported["nominal"]["cruise"]["cost_of_transport"] < cruise["cost_of_transport"]


def test_capability_prints_the_contracts_keys(run):
    options = "--stroke", "0.0754", "--frequency", "0.147", "--tether-per-metre", "0.5"
    few = "--frequencies", "0.147", "0.147"
    status, out, _ = run(capability, *QUICK, *few, *options, "--json")
    reported = json.loads(out)
    assert status == 0
    names = [each["name"] for each in reported["gaits"]]
    assert names == ["given", "min_power", "cruise", "max_speed"]
    for each in (*reported["gaits"], reported["best"]):
        assert set(each) >= {"gait", "largest_load", "largest_slope_deg"}
        assert each["tether_m"] == pytest.approx(each["largest_load"] / 0.5)
        assert reported["best"]["largest_load"] >= each["largest_load"] - 0.02
    assert 60.0 < reported["gaits"][0]["largest_slope_deg"] < 90.0
    assert reported["closed_form_largest_load"] == reported["best"]["closed_form_largest_load"]
    assert reported["loads"][0]["load"] == 0.0
