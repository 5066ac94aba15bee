# SPDX-License-Identifier: Apache-2.0
"""Random cases by seed: how many, and gaits and parameter sets over all kinds of dynamics that are admissible."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
from hypothesis import settings

from worm_model.gait import FORWARD, REVERSE, Gait, Profile
from worm_model.parameters import PAPER, Parameters

KINDS = ("paper", "perturbed", "heavy", "light damping", "double root", "resonant", "wide")


def seeds(count: int) -> range:
    """Return the seeds of costly random cases: ``count`` in continuous integration, a third of them elsewhere."""
    return range(count if os.environ.get("WORM_ALL_RANDOM_CASES") else count // 3)


def examples(count: int) -> settings:
    """Return the settings for as many random examples of Hypothesis."""
    return settings(max_examples=len(seeds(count)))


def random_case(seed: int) -> tuple[str, Gait, Parameters]:
    """Return (kind, gait, parameters) of a seed."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    gait = Gait(
        stroke=rng.uniform(0.005, 0.09),
        frequency=rng.uniform(0.08, 0.4),
        direction=FORWARD if rng.random() < 0.5 else REVERSE,
        margin=float(rng.choice([0.0, rng.uniform(0.0, 0.006)])),
    )
    changes = {"initial_length": PAPER.initial_length + rng.uniform(-0.5, 0.5) * PAPER.pitch}
    if kind != "paper":
        for key in (
            "bellows_stiffness",
            "bellows_damping",
            "viscous_friction",
            "engaged_stiffness",
            "disengaged_stiffness",
            "clearance",
            "time_constant",
            "gain",
            "slack",
        ):
            changes[key] = getattr(PAPER, key) * rng.uniform(0.7, 1.3)
        changes["rear_mass"] = rng.uniform(0.2, 0.8)
        changes["front_mass"] = rng.uniform(0.2, 0.8)
    if kind == "heavy":  # slow fin modes, complex where both fins touch
        changes["rear_mass"], changes["front_mass"] = rng.uniform(2.0, 10.0, 2)
    if kind == "light damping":
        changes["viscous_friction"] = rng.uniform(8.0, 25.0)
    if kind == "double root":  # exactly or nearly double where one fin touches with k_dis
        mass = changes["rear_mass"] + changes["front_mass"]
        critical = np.sqrt(mass * changes["disengaged_stiffness"])
        changes["viscous_friction"] = critical * (1.0 + rng.choice([0.0, 1e-9, 1e-5, -1e-7]))
    if kind == "resonant":  # −1/τ is a root, or nearly, where one fin touches with k_dis
        mass = changes["rear_mass"] + changes["front_mass"]
        friction = changes["viscous_friction"]
        root = friction - np.sqrt(friction**2 - mass * changes["disengaged_stiffness"])
        nearly = 1.0 + rng.choice([0.0, 1e-12, 1e-8, 1e-4])
        changes["time_constant"] = mass / root * nearly
    if kind == "wide":  # thresholds from well below to above the pitch, wide and no clearance
        changes["switching_threshold"] = PAPER.pitch * rng.uniform(0.6, 1.6)
        changes["clearance"] = rng.choice([0.0, rng.uniform(0.0, 0.9) * PAPER.pitch])
    return kind, gait, PAPER.replace(**{key: float(value) for key, value in changes.items()})


def random_loaded_case(seed: int) -> tuple[str, Gait, Parameters]:
    """Return the same with loads and waveforms; every third with dry friction, every second with a one-sided cable."""
    kind, gait, parameters = (random_dry_case if seed % 3 == 0 else random_case)(seed)
    rng = np.random.default_rng([seed, 2])
    gait = dataclasses.replace(
        gait,
        stroke=rng.uniform(0.02, 0.08),
        pretension=float(rng.choice([0.0, rng.uniform(0.0, 0.03)])),
        contraction_share=float(rng.choice([0.5, rng.uniform(0.2, 0.85)])),
        profile=Profile(int(rng.integers(0, 2))),
        ramp_share=float(rng.choice([0.1, 0.5, rng.uniform(0.1, 0.5)])),
    )
    rear, front = rng.uniform(-2.0, 6.0, 2)
    return (
        kind,
        gait,
        parameters.replace(
            rear_load=float(rng.choice([0.0, rear])),
            front_load=float(rng.choice([0.0, front])),
            one_sided_cable=bool(seed % 2),
        ),
    )


def random_dry_case(seed: int) -> tuple[str, Gait, Parameters]:
    """Return the same with dry friction, from a little to more than the fins can bear, of one module or of both."""
    kind, gait, parameters = random_case(seed)
    rng = np.random.default_rng([seed, 1])
    rear, front = np.exp(rng.uniform(np.log(0.02), np.log(20.0), 2))
    one = rng.integers(0, 4)  # 0: the rear module alone, 1: the front one
    return (
        kind,
        gait,
        parameters.replace(
            rear_dry_friction=0.0 if one == 1 else float(rear),
            front_dry_friction=0.0 if one == 0 else float(front),
        ),
    )
