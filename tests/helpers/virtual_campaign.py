# SPDX-License-Identifier: Apache-2.0
"""Campaigns of robots with known parameters, as input of the identification:

the ground truth of its tests and benchmark.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from recorded_run import EPOCH, make_run

from worm_driver.virtual_robot.offline_run import Rehearsal, run_offline
from worm_driver.virtual_robot.virtual_settings import RobotSettings, load_settings
from worm_model.gait import Gait
from worm_model.identification.data.observed_run import Recording, recordings_of
from worm_model.identification.inputs import BenchTest, Inputs
from worm_model.identification.reference_values import READING, ReferenceValues
from worm_model.parameters import PAPER, Parameters
from worm_model.run import Run

# Gaits and durations (s) that pass five ridges, as in a usual campaign
CAMPAIGN = (
    (Gait(0.06, 0.1), 34.5),
    (Gait(0.06, 0.2), 17.6),
    (Gait(0.07, 0.1), 34.0),
    (Gait(0.07, 0.2), 17.4),
    (Gait(0.07, 0.3), 11.8),
    (Gait(0.08, 0.15), 10.0),
    (Gait(0.08, 0.25), 6.4),
    (Gait(0.09, 0.2), 7.5),
)
SHORT = (CAMPAIGN[4], CAMPAIGN[5], CAMPAIGN[6], CAMPAIGN[7])
SPREAD = 0.05  # relative, of the true parameters about the virtual robot's
FORCE_NOISE = 0.12, 0.35  # N, of the fin and of the bellows test
# s before a gait; the cable is tensioned in their first half
REST, REST_UNDER_PRETENSION = 2.0, 3.0
TICK = 2.0 * np.pi / 4096  # rad


def recording_of(run: Run, name: str) -> Recording:
    """Return the recording of a run's first gait."""
    return recordings_of(run, name)[0]


@dataclass(frozen=True)
class VirtualCampaign:
    """Input of the identification, which includes errors of a scale and a ruler, and the true parameters."""

    inputs: Inputs
    reference: ReferenceValues
    truth: Parameters


def virtual_campaign(
    seed: int,
    plan: Sequence[tuple[Gait, float]] = CAMPAIGN,
    spread: float = SPREAD,
    cable_stiffness: float = 0.0,
) -> VirtualCampaign:
    """Return runs of one robot in one pipe, each with its own noise, and the robot's bench tests.

    ``cable_stiffness`` (N/m) is that of a compliant cable, which cannot push; 0 means rigid.
    """
    usual = load_settings()
    effects = dataclasses.replace(usual.effects, cable_stiffness=cable_stiffness)
    settings = dataclasses.replace(usual, seed=seed, parameter_spread=spread, effects=effects)
    recordings, truth = [], PAPER
    for index, (gait, duration) in enumerate(plan):
        run = run_offline(
            dataclasses.replace(settings, recording=index + 1),
            gait.length_change,
            duration,
            REST_UNDER_PRETENSION if gait.pretension else REST,
        )
        truth = Parameters(**dataclasses.asdict(run.truth))
        recordings.append(recording_of(run_of(run, gait, settings), f"run_{index + 1}"))
    bellows, fin = bench_tests(truth, np.random.default_rng(seed))
    given = ReferenceValues(read_off(truth, np.random.default_rng([seed, 1])), {}, "the maker")
    return VirtualCampaign(Inputs(tuple(recordings), bellows, fin, None), given, truth)


def read_off(truth: Parameters, random: np.random.Generator) -> Parameters:
    """Return the paper's values, except those read off a scale and a ruler, which are within their bounds in 95 %."""
    return PAPER.replace(
        **{
            key: getattr(truth, key) + reading / 1.96 * random.standard_normal()
            for key, reading in READING.items()
        }
    )


def bench_tests(truth: Parameters, random: np.random.Generator) -> tuple[BenchTest, BenchTest]:
    """Return a bellows and a fin test as a lab performs them."""
    x = np.linspace(-0.012, 0.012, 97)
    force = truth.engaged_stiffness * np.minimum(x + 0.5 * truth.clearance, 0.0)
    force += truth.disengaged_stiffness * np.maximum(x - 0.5 * truth.clearance, 0.0)
    fin = BenchTest(x, force + random.normal(0.0, FORCE_NOISE[0], x.size), "")
    compression = np.linspace(0.0, 0.07, 36)
    load = truth.bellows_stiffness * compression
    bellows = BenchTest(compression, load + random.normal(0.0, FORCE_NOISE[1], 36), "")
    return bellows, fin


def run_of(rehearsal: Rehearsal, gait: Gait, settings: RobotSettings, epoch: int = EPOCH) -> Run:
    """Return a rehearsal as a bag would contain it, which begins at a time in ns."""
    servo = settings.cable_servos[0]
    metres = -servo.sign * servo.spool_radius * TICK
    return make_run(
        gait,
        rehearsal.onset,
        (rehearsal.tracker_time, rehearsal.rear_position, rehearsal.front_position),
        (rehearsal.servo_time, rehearsal.goal_ticks * metres),
        (rehearsal.power_time, rehearsal.bus_voltage * rehearsal.current),
        epoch=epoch,
    )
