# SPDX-License-Identifier: Apache-2.0
"""The twin's findings about faulty robots, which are integrated independently of worm_model."""

import dataclasses
import math
from functools import lru_cache

import numpy as np
import pytest
from faulty_robots import ONSET, Fault, Lab, Robots, causes, followed, run_robots
from scipy.stats import multivariate_normal
from twin_samples import run_of_rows
from virtual_campaign import REST, run_of

from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.analysis.replay_metrics import report_replay
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import LengthSamples, TrackerSamples
from worm_model.twin.data.records import Event, Health, Severity
from worm_model.twin.data.samples import SampleKind
from worm_model.twin.inference import NullModel
from worm_model.twin.offline_replay import replay_run
from worm_model.twin.twin import Twin

GAIT = Gait(0.08, 0.2)
FAULTS = (
    Fault(),
    Fault("rear", 1, 3),
    Fault("front", 1, 3),
    Fault("gained", 1, 3),
    Fault("gain", -0.02, 3, 0.3),
    Fault("slip", 0.003, 2, 0.6),
    Fault("viscous_friction", 1.0, 3),
    Fault("scale", 0.08, 2),
    Fault("scale", -0.12, 2),
    Fault("offset", 0.6, 3, 0.3),
    Fault("robot", 3, 3, 0.3),
    Fault("camera", 0.008, 3, 0.3),
    Fault("rear", 2, 3),
    Fault("front", 2, 3),
)
CODES = {
    "rear": "missed_groove_rear",
    "front": "missed_groove_front",
    "gained": "gained_groove",
    "gain": "cable_slip",
    "slip": "cable_slip",
    "viscous_friction": "friction_up",
    "scale": "power_scale",
    "offset": "power_offset",
    "robot": "robot_moved",
    "camera": "camera_moved",
}


@lru_cache
def robots() -> Robots:
    """Return one robot for each fault, all with the same gait."""
    return run_robots(GAIT, FAULTS, seed=5)


def reported(fault: Fault, **instruments: bool) -> list[Event]:
    """Return the twin's events about a fault."""
    return causes(robots().rows(FAULTS.index(fault), **instruments))


def cycles_late(event: Event, fault: Fault) -> float:
    return (event.stamp_ns - ONSET) * 1e-9 / GAIT.period - fault.cycle


@pytest.mark.parametrize("fault", FAULTS, ids=lambda f: f"{f.kind} {f.size:g}")
def test_with_a_tracker_each_cause_is_named_within_two_cycles_and_no_other(fault: Fault):
    found = reported(fault, tracker=True)
    assert (
        [event.code for event in found]
        == [CODES[fault.kind]] * (int(fault.size) if fault.kind in ("rear", "front") else 1)
        if fault.kind != "healthy"
        else not found
    )
    if found:
        assert cycles_late(found[0], fault) < 1.1
        assert found[0].cycle in (fault.cycle, fault.cycle + (fault.phase > 0.5))
        assert found[0].probability > 0.9


@pytest.mark.parametrize(
    "fault",
    [f for f in FAULTS if f.kind not in ("gained", "robot")],
    ids=lambda f: f"{f.kind} {f.size:g}",
)
def test_power_alone_names_the_fin_the_slipped_cable_and_the_sensor(fault: Fault):
    codes = {event.code for event in reported(fault, tracker=False)}
    if fault.kind in ("gain", "scale", "viscous_friction"):  # which power alone cannot distinguish
        assert not any("groove" in code or "load" in code for code in codes)
    else:
        assert codes == (set() if fault.kind in ("healthy", "camera") else {CODES[fault.kind]})


@pytest.mark.parametrize("size", [3.0, 4.0])
def test_much_more_friction_does_not_change_the_scale_of_the_power_too(size: float):
    """The power is not linear in so large a change, and the remainder looks like another scale."""
    faults = [Fault("viscous_friction", size, 3, phase) for phase in (0.0, 0.3, 0.6)]
    rows = run_robots(GAIT, faults, seed=7, cycles=7).rows(2, tracker=True)
    codes = [event.code for event in causes(rows)]
    assert "friction_up" in codes
    assert "power_scale" not in codes


@pytest.mark.parametrize("fault", [f for f in FAULTS if f.size == 2])
def test_two_misses_running_do_not_move_l0_though_the_front_marker_is_hidden(fault: Fault):
    found = reported(fault, tracker=True, front_marker=False)
    assert [event.cycle for event in found] == [3, 4]
    assert all(event.code.startswith("missed_groove") for event in found)


@pytest.mark.parametrize("tracker", [True, False])
@pytest.mark.parametrize(("begin_cycle", "codes"), [(1, {"missed_groove_rear"}), (2, set())])
def test_of_a_recording_that_begins_in_a_gait_the_first_whole_cycle_is_not_judged(
    tracker: bool, begin_cycle: int, codes: set[str]
):
    """Without a stored memory, the fins' grooves are unknown; the third cycle has a miss."""
    rows = robots().rows(FAULTS.index(Fault("rear", 1, 3)), tracker=tracker)
    begin = ONSET + round((begin_cycle - 0.6) * GAIT.period * 10**9)
    latched = rows[(rows["kind"] == SampleKind.GAIT) & (rows["stamp"] < begin)][-1:]
    run = run_of_rows(np.concatenate([latched, rows[rows["stamp"] >= begin]]))
    (report,) = report_replay(run, replay_run(run, PAPER), PAPER.pitch).runs
    assert {event.code for _, event in report.events} == codes
    whole = [cycle for cycle in report.cycles if cycle.complete]
    assert [cycle.number for cycle in whole if cycle.not_judged] == [begin_cycle + 1]


@pytest.mark.parametrize(
    "lab",
    [
        Lab(camera_hz=10.0),
        Lab(camera_noise_m=0.7e-3),  # 1 mm of length
        Lab(camera_hz=10.0, camera_noise_m=0.7e-3),
        Lab(power_noise_W=0.3),
    ],
    ids=("camera at 10 Hz", "noisy camera", "noisy camera at 10 Hz", "noisy power"),
)
def test_a_slow_camera_and_noise_make_no_healthy_robot_suspect(lab: Lab):
    seen = run_robots(GAIT, [Fault(), Fault()], seed=8, lab=lab)
    for robot in range(2):
        power = {}
        for tracker in (True, False):
            output = followed(seen.rows(robot, tracker=tracker))
            assert not [event.text for event in output.events if event.code]
            after = output.residuals[output.residuals["stamp_ns"] > ONSET + 10**9]
            first = after["stamp_ns"] < ONSET + round(1.1 * GAIT.period * 10**9)
            # Without a length, nothing can be judged before the first cycle has shown the fins' grooves.
            assert set(after["health"][first]) <= {Health.HEALTHY, Health.UNKNOWN}
            assert set(after["health"][~first]) == {Health.HEALTHY}
            power[tracker] = np.nanmean(after["power"])
        assert power[True] == pytest.approx(
            power[False], abs=0.12
        )  # W, 3 %: difference between measured and predicted length


def test_noise_of_another_weight_is_weighed_as_its_density():
    """Compared with the normal density of all data at once, with its whole covariance."""
    draw = np.random.default_rng(1)
    seen, nuisances = draw.normal(size=(3, 4)), draw.normal(size=(3, 4, 2))
    weight, offsets = draw.uniform(0.5, 2.0, (3, 4)), np.array([0.0, 0.5, 2.0, 1.0])
    others = np.array([weight, weight])
    others[1, 2] /= 7.0

    def log_density(weights: np.ndarray) -> float:
        directions = nuisances.reshape(12, 2)
        covariance = np.diag(1.0 / weights.ravel()) + directions @ directions.T
        covariance += np.kron(np.ones((3, 3)), np.diag(offsets**2))
        return float(multivariate_normal(cov=covariance).logpdf(seen.ravel()))

    found = NullModel(seen, others, nuisances, offsets).log_densities()
    found -= NullModel(seen, weight, nuisances, offsets).log_densities()
    assert found == pytest.approx([0.0, log_density(others[1]) - log_density(weight)], abs=1e-9)


def test_the_bayes_factor_is_that_of_the_integral():
    """Compared with a sum over the size of the cause and that of a nuisance; one bin's offset is another nuisance."""
    draw = np.random.default_rng(0)
    seen, cause, nuisance = draw.normal(size=(3, 6, 1))
    weight = 1.0 / draw.uniform(0.5, 2.0, (6, 1))
    grid = np.linspace(-8.0, 8.0, 1601)
    normal = np.exp(-0.5 * grid**2) / math.sqrt(2 * math.pi) * (grid[1] - grid[0])

    def likelihood(size: float) -> float:
        rest = (seen - size * cause)[:, 0] - grid[:, None] * nuisance[:, 0]
        return float(normal @ np.exp(-0.5 * rest**2 @ weight[:, 0]))

    none = likelihood(0.0)
    integral = sum(p * likelihood(s) for p, s in zip(normal, grid, strict=True))
    null = NullModel(seen, weight, nuisance[..., None], np.zeros(1))
    found = null.weigh(np.array([cause, cause]), np.array([False, True]))
    as_offset = NullModel(seen, weight, np.zeros((6, 1, 0)), np.ones(1))
    constant = NullModel(seen, weight, np.ones((6, 1, 1)), np.zeros(1))
    both = [each.weigh(cause[None], np.array([False])).evidence for each in (as_offset, constant)]
    assert both[0] == pytest.approx(both[1], abs=1e-12)
    assert found.evidence[0] == pytest.approx(math.log(integral / none), abs=1e-6)
    assert found.evidence[1] == pytest.approx(math.log(likelihood(1.0) / none), abs=1e-6)


def test_one_marker_distinguishes_a_wrong_l0_from_misses():
    """The twin assumes 295.2 mm; 293 mm gain another number of grooves and change the shape of x1."""
    truth = PAPER.replace(initial_length=0.293)
    one = run_robots(Gait(0.07, 0.2), [Fault()], seed=6, truth=truth)
    rows = one.rows(0, tracker=True, front_marker=False)
    twin = Twin()
    state = twin.start()
    events = twin.advance(state, rows, to_the_end=True).events
    codes = [event.code for event in events if event.code]
    assert codes[-1] == "initial_length"
    assert codes.count("initial_length") == 1
    assert len(codes) <= 2  # one cycle cannot distinguish it from a gained groove
    assert state.initial_length == pytest.approx(0.293, abs=1.5e-3)


@pytest.mark.parametrize("phase", [-0.0075, 0.002])
@pytest.mark.parametrize("tracked", [True, False])
def test_a_compliant_cable_that_the_model_lacks_is_no_fault(phase: float, tracked: bool):
    """The body is longer than the command in every cycle, by an amount that depends on the fins."""
    count = round((PAPER.initial_length - phase) / PAPER.pitch)
    parameters = PAPER.replace(initial_length=count * PAPER.pitch + phase)
    usual = load_settings()
    robot = dataclasses.replace(
        usual,
        effects=dataclasses.replace(usual.effects, cable_stiffness=6400.0),
        body=dataclasses.replace(usual.body, initial_length=parameters.initial_length),
    )
    run = run_of(run_offline(robot, GAIT.length_change, 5.1 * GAIT.period, REST), GAIT, robot)
    changes = {} if tracked else {"tracker": TrackerSamples(), "measured": LengthSamples()}
    replay = replay_run(dataclasses.replace(run, **changes), parameters)
    assert {event.code for event in replay.notices if event.severity > Severity.INFO} == set()
