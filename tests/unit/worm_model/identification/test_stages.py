# SPDX-License-Identifier: Apache-2.0
"""Stages 4, 5 and 7 on robots that follow the model exactly, and on some that do not."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_run import Instruments, exact_run
from virtual_campaign import recording_of

from worm_model.gait import Gait
from worm_model.identification import locomotion_stage
from worm_model.identification.actuation_stage import identify_actuation
from worm_model.identification.energy_stage import identify_energy
from worm_model.identification.fits import locomotion
from worm_model.identification.fits.actuation_fit import fit_actuation
from worm_model.identification.fits.block_least_squares import solve
from worm_model.identification.fits.energy import fit_energy, power_run
from worm_model.identification.fits.groove_scatter import MEANS, fit_grooves
from worm_model.identification.fits.measured_length import measured_length
from worm_model.parameters import PAPER
from worm_model.simulation.kernel.grooves import FIRST_GROOVE
from worm_model.simulation.kernel.march import X1
from worm_model.simulation.simulator import simulate

TRUTH = PAPER.replace(
    viscous_friction=95.0,
    switching_threshold=0.0171,
    slack=0.0072,
    gain=0.84,
    time_constant=0.17,
    bellows_damping=900.0,
    power_factor=3.0,
)
PITCH_DEVIATION = 2.5e-5  # m, of a ruler over ten ridges
KNOWN = locomotion.Known(TRUTH, PITCH_DEVIATION)
GAITS = [Gait(0.08, 0.15), Gait(0.08, 0.25), Gait(0.09, 0.2)]


def recordings(truth=TRUTH, gaits=GAITS, cycles=1.7, **instruments):
    return [
        recording_of(
            exact_run(gait, truth, Instruments(**instruments), seed, cycles / gait.frequency),
            f"run_{seed}",
        )
        for seed, gait in enumerate(gaits)
    ]


def traverses(truth=TRUTH, **details):
    return [
        locomotion.traverse_of(recording, measured_length(recording), truth.pitch)
        for recording in recordings(truth, **details)
    ]


def solved(runs, viscous_friction=90.0):
    """Return the solution of the locomotion problem from a start near the truth."""
    start = np.array([viscous_friction, 0.0172, 0.05, 0.05, TRUTH.pitch, 0.5])
    return solve(locomotion.locomotion_problem(runs, KNOWN), start, locomotion.first_own(runs))


def test_actuation_is_found_and_the_clocks_with_it():
    fit = fit_actuation(recordings(camera_noise=1e-5, camera_behind=0.007))
    assert fit.values == pytest.approx([0.0072, 0.84, 0.17], rel=2e-3)
    assert fit.clock_offset == pytest.approx(np.full(3, 0.007), abs=6e-4)
    assert fit.initial_length == pytest.approx(np.full(3, TRUTH.initial_length), abs=1e-5)


def test_the_bootstrap_repeats_with_its_seed():
    found = recordings()
    first, again, other = (
        identify_actuation(found, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert first.slack == again.slack
    assert first.slack != other.slack
    assert first.slack.low < 0.0072 < first.slack.high


@pytest.mark.parametrize("off", [-5e-5, 0.0, 5e-5])
def test_the_valley_is_found_from_nothing_and_a_pitch_read_off_wrongly_is_put_right(off):
    runs = traverses(camera_noise=1e-4)
    given = TRUTH.replace(
        viscous_friction=300.0, switching_threshold=0.012, pitch=TRUTH.pitch + off
    )
    known = locomotion.Known(given, PITCH_DEVIATION)
    valleys = locomotion.search(runs, known)
    assert off or valleys[0, 1] == pytest.approx(TRUTH.switching_threshold, abs=4e-4)
    solution = locomotion.find_locomotion(runs, known, valleys)
    assert solution.shared[0] == pytest.approx(95.0, rel=0.02)
    assert solution.shared[1] == pytest.approx(TRUTH.switching_threshold, abs=5e-5)
    assert solution.shared[2:4] == pytest.approx([0.0, 0.0], abs=0.05)
    assert solution.shared[4] == pytest.approx(TRUTH.pitch, abs=1e-5)


def test_runs_that_never_pass_a_groove_determine_friction_but_no_threshold():
    gaits = [Gait(0.03, 0.15), Gait(0.03, 0.25)]
    runs = traverses(gaits=gaits, cycles=3.0, camera_noise=1e-4)
    result = locomotion_stage.identify_locomotion(runs, KNOWN)
    assert result.viscous_friction.low < TRUTH.viscous_friction < result.viscous_friction.high
    assert not result.switching_threshold.identifiable


@pytest.mark.parametrize(
    ("dry", "onset"), [((0.1, 0.1), 0.0), ((0.1, 0.1), 1.0), ((0.4, 0.2), 0.0)]
)
def test_how_the_body_sets_in_is_found_and_dry_friction_is_not_booked_as_viscous(dry, onset):
    alike = np.zeros((10, 2))
    solution = solved(rough_traverses(dry, alike, alike, onset), 80.0)
    assert solution.shared[0] == pytest.approx(95.0, rel=0.02)
    assert solution.shared[2:4] == pytest.approx(dry, abs=0.05)
    assert solution.shared[5] == pytest.approx(onset, abs=0.25)


def test_less_than_a_cycle_of_one_run_determines_no_actuation():
    result = identify_actuation(recordings(gaits=GAITS[:1], cycles=0.9), np.random.default_rng(0))
    for estimate in (result.slack, result.gain, result.time_constant):
        assert not estimate.identifiable
        assert estimate.note


def test_a_cable_without_slack_is_not_given_an_interval_at_the_bound():
    found = [replace(r, command=r.command + 0.002) for r in recordings(TRUTH.replace(slack=0.0))]
    slack = identify_actuation(found, np.random.default_rng(0)).slack
    assert (slack.value, slack.identifiable) == (0.0, False)
    assert "bound" in slack.note


@pytest.mark.parametrize("gain", [2.0, 30.0])
def test_a_better_fit_is_better_by_the_scale_of_the_residuals(monkeypatch, gain):
    """Where residuals are 20 times those of the camera, a cost that is lower by 2 is no other fit."""
    runs = traverses(camera_noise=1e-4)
    fit = fit_grooves(runs, KNOWN, solved(runs))

    def held(present, entry, value):
        off = (value - present.means[entry]) / locomotion_stage.FIRST_REACH[entry]
        return replace(present.solution, cost=present.solution.cost - gain + off**2)

    monkeypatch.setattr(locomotion_stage, "held", held)
    monkeypatch.setattr(locomotion_stage, "solve", lambda _problem, shared, own: fit.solution)
    intervals, better = locomotion_stage._profiles(fit, 20.0)
    assert (better is None) == (gain < 20.0 * locomotion_stage.BETTER)
    assert len(intervals) == (3 if better is None else 0)


def test_an_impossible_motion_leaves_the_given_values():
    runs = traverses(camera_noise=1e-4)[:1]
    wrong = [replace(run, x1=run.x1 - 40.0) for run in runs]
    result = locomotion_stage.identify_locomotion(wrong, KNOWN)
    assert result.trouble == locomotion_stage.UNEXPLAINED
    assert not result.viscous_friction.identifiable
    assert result.viscous_friction.value == TRUTH.viscous_friction


def rough_traverses(dry, rear_grooves, front_grooves, onset=0.0):
    """Return runs of a worm with dry friction in uneven grooves, by the identification's own model."""
    random = np.random.default_rng(8)
    found = []
    for run in traverses(camera_noise=1e-4):
        means = np.array([95.0, 0.0171, *dry, TRUTH.pitch, onset])
        worm = locomotion.with_means(locomotion.worm_of(TRUTH), means, np.array([0.2952, 0.0]))
        samples = locomotion.follow(run, worm, run.sampled, rear_grooves, front_grooves)
        x1 = samples[1:, X1]
        found.append(replace(run, x1=x1 + random.normal(0.0, 1e-4, x1.size), noise=1e-4))
    return found


def test_the_intervals_cover_the_dry_friction_of_the_simulator():
    """Identification writes to a parameter file the law that the simulator reads from it."""
    truth = TRUTH.replace(rear_dry_friction=0.3, front_dry_friction=0.3)
    runs = traverses(truth, gaits=[Gait(0.07, 0.3), *GAITS], camera_noise=2e-4)
    result = locomotion_stage.identify_locomotion(runs, KNOWN)
    assert result.viscous_friction.low < truth.viscous_friction < result.viscous_friction.high
    for estimate in (result.rear_dry_friction, result.front_dry_friction):
        assert estimate.low < 0.3 < estimate.high
        assert estimate.spread < 0.1


def test_grooves_that_differ_are_distinguished():
    random = np.random.default_rng(3)
    rear, front = (
        np.stack([random.normal(0.0, 2e-4, 10), random.normal(0.0, 0.03, 10)], axis=1)
        for _ in range(2)
    )
    runs = rough_traverses((0.2, 0.2), rear, front)
    flat = solved(runs)
    fit = fit_grooves(runs, KNOWN, flat)
    assert fit.solution.cost < 0.8 * flat.cost
    assert 1e-4 < fit.scatter.threshold < 4e-4
    assert 0.01 < fit.scatter.stiffness < 0.06
    first = [tuple(place) for place in fit.places].index((0, FIRST_GROOVE, 0))
    found = fit.means[1] + fit.solution.shared[MEANS + first]
    assert found == pytest.approx(0.0171 + rear[FIRST_GROOVE, 0], abs=6e-5)


def power_runs(gaits, random, factor_scatter=0.01, truth=TRUTH, one_sided_cable=False):
    """Return runs with the exact model's force, each with a slightly different power factor."""
    found = []
    for gait, recording in zip(gaits, recordings(truth, gaits, camera_noise=1e-5), strict=True):
        motion = simulate(gait, truth, 3).at(np.arange(0.0, 1.6 / gait.frequency, 0.008))
        static = motion.cable_force + TRUTH.bellows_damping * motion.length_rate
        own = 1.0 + factor_scatter * random.standard_normal()
        power = TRUTH.idle_power + own * (recording.power - TRUTH.idle_power)
        found.append(
            power_run(
                replace(recording, power=power),
                motion.time,
                motion.length_rate,
                static,
                1.5 / gait.frequency,
                TRUTH.idle_power,
                one_sided_cable=one_sided_cable,
            )
        )
    return found


def energy_of(gaits, seed=0):
    random = np.random.default_rng(seed)
    runs = power_runs(gaits, random)

    def forces(_):
        return [run.static_force for run in runs]

    return identify_energy(runs, forces, PAPER, random)


def test_damping_and_power_factor_are_found_from_several_frequencies():
    gaits = [Gait(0.07, f) for f in (0.1, 0.15, 0.2, 0.3)]
    result = energy_of(gaits)
    assert result.bellows_damping.identifiable
    assert result.bellows_damping.low < 900.0 < result.bellows_damping.high
    assert result.power_factor.low < 3.0 < result.power_factor.high
    assert result.correlation[0, 1] < -0.8


def test_the_form_of_the_power_that_the_robot_has_finds_its_damping_and_factor():
    gaits = [Gait(0.09, f) for f in (0.1, 0.2, 0.3, 0.4)]
    truth = TRUTH.replace(one_sided_cable=True)
    forms = {
        form: fit_energy(power_runs(gaits, np.random.default_rng(0), 0.0, truth, form))
        for form in (True, False)
    }
    assert forms[True].damping == pytest.approx(900.0, rel=0.01)
    assert forms[True].factor == pytest.approx(3.0, rel=0.01)
    assert abs(forms[False].damping - 900.0) > 90.0
    assert forms[False].solution.cost > 10.0 * forms[True].solution.cost


def test_one_frequency_cannot_distinguish_damping_from_power_factor():
    result = energy_of([Gait(stroke, 0.2) for stroke in (0.06, 0.07, 0.08, 0.09)])
    for estimate in (result.bellows_damping, result.power_factor):
        assert not estimate.identifiable
        assert np.isnan(estimate.low)
        assert "another frequency" in estimate.note
    assert result.bellows_damping.value == 862.4  # as entered, without false digits
