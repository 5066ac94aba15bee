# SPDX-License-Identifier: Apache-2.0
"""Many robots at once with faults, integrated step by step and independently of worm_model.

Their driver, camera and power sensor provide samples for the twin. Each robot deviates from the twin's parameters and
has dry friction, grooves that differ and noisy instruments. A fault begins in a cycle at a phase. A fin's miss belongs
to the cycle in which x1 falls behind: the front fin's miss happens at the end of the cycle before. SI units; forward is
+x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from worm_model.parameters import PAPER, Parameters
from worm_model.run import Activity
from worm_model.twin.data.samples import SampleKind, sample_rows
from worm_msgs.gait import GAIT_UNITS, Gait

ONSET = 1_700_000_000_000_000_000
STEP_S = 1e-3
REST_S, AFTER_S = 2.0, 1.0
COMMAND_HZ, POWER_HZ = 100, 100
GROOVES = 64
CARRIED_S = 0.5  # duration in which a person moves a robot
EARLY_M = 0.010  # distance by which a fin that gains a groove switches too early
SLOW = 1e-3  # m/s below which dry friction fades


@dataclass(frozen=True)
class Fault:
    """Fault of one robot, from a phase of a cycle on.

    ``kind`` is healthy; gain, viscous_friction, scale (``size`` relative); slip, camera (m); offset (W); rear_load,
    both_loads (N, the latter shared by the modules); robot, gained (grooves); rear, front (number of successive cycles
    in which a fin misses its last groove).
    """

    kind: str = "healthy"
    size: float = 0.0
    cycle: int = 3
    phase: float = 0.0


@dataclass(frozen=True)
class Lab:
    """Noise of the instruments, deviation of the robots from the twin's parameters (relative), and of the grooves."""

    camera_hz: float = 30.0
    camera_noise_m: float = 0.0002
    power_noise_W: float = 0.06
    spread: float = 0.01
    dry_friction_N: float = 0.3
    threshold_m: float = 0.0002
    stiffness: float = 0.02


EXACT = Lab(
    camera_noise_m=1e-5,
    power_noise_W=1e-3,
    spread=0.0,
    dry_friction_N=0.0,
    threshold_m=0.0,
    stiffness=0.0,
)
NOT_SPREAD = ("rear_mass", "front_mass", "unstressed_length", "initial_length", "pitch")


@dataclass(frozen=True)
class Robots:
    """True grooves of k robots, and measurements: times (n,) in s from the onset, values (n, k)."""

    gait: Gait
    cycles: int
    command_time: np.ndarray
    camera_time: np.ndarray
    rear: np.ndarray
    front: np.ndarray
    power_time: np.ndarray
    power: np.ndarray
    grooves: np.ndarray  # (cycles, k) gained in each cycle, along +x

    def rows(self, robot: int, *, tracker: bool, front_marker: bool = True) -> np.ndarray:
        """Return the samples for the twin; with both markers the camera measures the length, too."""
        gait = self.gait
        command = np.where(self.command_time > 0.0, _command(gait, self.command_time), 0.0)
        command[self.command_time > self.cycles * gait.period] = 0.0
        parts = [
            _rows(SampleKind.COMMAND, self.command_time, command),
            _rows(SampleKind.POWER, self.power_time, self.power[:, robot]),
        ]
        rear, front = self.rear[:, robot], self.front[:, robot]
        if tracker:
            seen = front if front_marker else front * np.nan
            parts.append(_rows(SampleKind.POSITION, self.camera_time, rear, seen))
        if tracker and front_marker:
            parts.append(_rows(SampleKind.LENGTH, self.camera_time, front - rear))
        states = [(-1.5, Activity.RESTING, 0)]
        states += [(k * gait.period, Activity.RUNNING, k + 1) for k in range(self.cycles)]
        states.append((self.cycles * gait.period + 0.003, Activity.IDLE, self.cycles))
        values = [np.array([float(getattr(gait, name))]) for name in GAIT_UNITS]
        for time, activity, cycle in states:
            row = sample_rows(SampleKind.GAIT, _stamps(np.array([time])), *values)
            row["state"], row["cycle"] = activity, cycle
            row["onset"], row["run"] = (ONSET if activity == Activity.RUNNING else 0), 1
            parts.append(row)
        rows = np.concatenate(parts[::-1])  # the driver's states before samples of the same stamp
        return rows[np.argsort(rows["stamp"], kind="stable")]


def _rows(kind: SampleKind, time: np.ndarray, *values: np.ndarray) -> np.ndarray:
    return sample_rows(kind, _stamps(time), *values)


def _stamps(time: np.ndarray) -> np.ndarray:
    return ONSET + np.rint(time * 1e9).astype(np.int64)


def _command(gait: Gait, time: np.ndarray) -> np.ndarray:
    return -0.5 * gait.stroke * (1.0 - np.cos(2.0 * np.pi * gait.frequency * time))


def run_robots(
    gait: Gait,
    faults: Sequence[Fault],
    seed: int = 0,
    cycles: int = 5,
    lab: Lab = Lab(),
    truth: Parameters = PAPER,
    usual: int = 2,
) -> Robots:
    """Return a robot for each fault, with its own noise, parameters and grooves.

    A healthy robot gains ``usual`` grooves per cycle.
    """
    draw = np.random.default_rng(seed)
    bodies = _Bodies(gait, faults, lab, truth, usual, draw)
    end = cycles * gait.period
    times = np.arange(-round(REST_S / STEP_S), round((end + AFTER_S) / STEP_S) + 1) * STEP_S
    camera_k = np.rint(np.arange(0.0, times[-1] - times[0], 1.0 / lab.camera_hz) / STEP_S).astype(
        int
    )
    looks, cycle_ends = (
        set(camera_k.tolist()),
        {round((c * gait.period - times[0]) / STEP_S) for c in range(cycles + 1)},
    )
    seen, powers, ends = [], [], []
    for k, time in enumerate(times.tolist()):
        commanded = float(_command(gait, np.array(time))) if 0.0 < time < end else 0.0
        bodies.step(time, commanded)
        if k % round(1 / POWER_HZ / STEP_S) == 0:
            powers.append(bodies.power * (1.0 + bodies.of("scale")) + bodies.of("offset"))
        if k in looks:
            seen.append(bodies.x + bodies.of("camera")[:, None])
        if k in cycle_ends:
            ends.append(bodies.x[:, 0])
    positions, power = np.array(seen), np.array(powers)
    positions = 0.4 + positions + lab.camera_noise_m * draw.normal(size=positions.shape)
    return Robots(
        gait,
        cycles,
        times[:: round(1 / COMMAND_HZ / STEP_S)],
        times[camera_k],
        positions[:, :, 0],
        positions[:, :, 1],
        times[:: round(1 / POWER_HZ / STEP_S)],
        power + lab.power_noise_W * draw.normal(size=power.shape),
        np.rint(np.diff(np.array(ends), axis=0) / truth.pitch).astype(int),
    )


class _Bodies:
    """Robots between two steps: ``x`` (k, 2) in m, source ``power`` (k,) in W."""

    def __init__(
        self,
        gait: Gait,
        faults: Sequence[Fault],
        lab: Lab,
        truth: Parameters,
        usual: int,
        draw: np.random.Generator,
    ) -> None:
        count = len(faults)
        self.gait, self.lab, self.usual = gait, lab, usual
        self.p = p = _parameters(truth, lab, count, draw)
        self.pitch = truth.pitch
        shape = (count, 2, GROOVES)
        self.limits = p["switching_threshold"][:, None, None] + lab.threshold_m * draw.normal(
            size=shape
        )
        self.factors = np.maximum(1.0 + lab.stiffness * draw.normal(size=shape), 0.2)
        self.kinds = np.array([fault.kind for fault in faults])
        self.sizes = np.array([fault.size for fault in faults])
        self.cycle = np.array([fault.cycle for fault in faults])
        self.begins = np.array([(f.cycle - 1 + f.phase) * gait.period for f in faults])
        self.mu = p["front_mass"] / (p["rear_mass"] + p["front_mass"])
        zero = np.zeros(count)
        self.change, self.rate, self.centre, self.speed, self.v1 = (zero.copy() for _ in range(5))
        self.taut, self.on = np.zeros(count, bool), np.zeros(count, bool)
        self.anchor = np.zeros((count, 2), int)
        self.anchor[:, 1] = np.rint(p["initial_length"] / self.pitch)
        self.switches, self.stood = np.zeros((count, 2), int), np.zeros((count, 2))
        self.x, self.power = np.zeros((count, 2)), zero

    def of(self, kind: str) -> np.ndarray:
        """Return the sizes of the present faults of one kind, 0 for the other robots."""
        return np.where((self.kinds == kind) & self.on, self.sizes, 0.0)

    def step(self, time: float, commanded: float) -> None:
        """Advance by one step to a time (s) under a command (m)."""
        self.on = time >= self.begins
        self._pull(commanded)
        carried = (self.kinds == "robot") & self.on & (time < self.begins + CARRIED_S)
        self.centre = self.centre + np.where(
            carried, self.sizes * self.pitch * STEP_S / CARRIED_S, 0.0
        )
        rear = self.centre - self.mu * self.change
        self.x = np.stack([rear, rear + self.p["initial_length"] + self.change], 1)
        self._switch(time, carried)
        self._push(self._fins(carried))

    def _pull(self, commanded: float) -> None:
        p = self.p
        self.taut |= commanded < -5e-5
        pulled = np.minimum(commanded + self.of("slip"), np.where(self.taut, -p["slack"], 0.0))
        goal = p["gain"] * (1.0 + self.of("gain")) * pulled
        self.change = goal + (self.change - goal) * np.exp(-STEP_S / p["time_constant"])
        self.rate = (goal - self.change) / p["time_constant"]

    def _switch(self, time: float, carried: np.ndarray) -> None:
        """Move anchors on where a fin passes its ridge, and to other grooves where a person puts the robot down."""
        within = (time / self.gait.period) % 1.0
        step = STEP_S / self.gait.period
        if within < step:
            self.switches[:, 0] = 0
        elif abs(within - 0.5) < 0.6 * step:
            self.switches[:, 1] = 0
        robots = np.arange(len(self.kinds))
        limit = np.stack([self.limits[robots, f, self.anchor[:, f] % GROOVES] for f in (0, 1)], 1)
        limit = self._at_fault(limit, time / self.gait.period - (self.cycle - 1))
        stretch = self.x - self.anchor * self.pitch
        moves = (stretch > limit).astype(int) - (stretch < -limit).astype(int)
        moves[carried] = 0
        down = (self.kinds == "robot") & (np.abs(time - self.begins - CARRIED_S) < 0.6 * STEP_S)
        moves[down] = np.rint((stretch - self.stood)[down] / self.pitch)
        self.anchor = self.anchor + moves
        self.switches += np.abs(moves)
        self.stood = np.where(carried[:, None], self.stood, stretch)

    def _at_fault(self, limit: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Return the thresholds with a fin that misses its last switch, or switches once too often.

        ``phase`` counts from the fault's cycle.
        """
        kinds, switches, usual = self.kinds, self.switches, self.usual
        rear = (kinds == "rear") & (phase > 0.0) & (phase < self.sizes) & (phase % 1.0 < 0.8)
        rear &= switches[:, 0] >= usual - 1
        phase_of_front = phase + 0.5
        front = (kinds == "front") & (phase_of_front > 0.0) & (phase_of_front < self.sizes)
        front &= (phase_of_front % 1.0 < 0.8) & (switches[:, 1] >= usual - 1)
        gained = (kinds == "gained") & (phase > 0.0) & (phase < 0.6) & (switches[:, 0] == usual)
        limit[rear, 0], limit[front, 1] = 1.0, 1.0
        limit[gained, 0] -= EARLY_M
        return limit

    def _fins(self, carried: np.ndarray) -> np.ndarray:
        """Return the forces (k, 2) of the fins and the loads, N."""
        p, robots = self.p, np.arange(len(self.kinds))
        stretch = np.where(carried[:, None], 0.0, self.x - self.anchor * self.pitch)
        forces = []
        for f in (0, 1):
            s = stretch[:, f]
            beyond = np.sign(s) * np.maximum(np.abs(s) - 0.5 * p["clearance"], 0.0)
            held = self.gait.direction * s < 0.0
            stiffness = np.where(held, p["engaged_stiffness"], p["disengaged_stiffness"])
            fin = stiffness * self.factors[robots, f, self.anchor[:, f] % GROOVES] * beyond
            own = p["front_load"] if f else p["rear_load"] + self.of("rear_load")
            forces.append(fin + own + 0.5 * self.of("both_loads"))
        return np.stack(forces, 1)

    def _push(self, forces: np.ndarray) -> None:
        """Move the centre of mass, with implicit friction, and compute the power that the cable needs."""
        p, mu, rate = self.p, self.mu, self.rate
        mass = (p["rear_mass"] + p["front_mass"]) / STEP_S
        before = self.speed - mu * rate
        viscous = p["viscous_friction"] * (1.0 + self.of("viscous_friction"))
        d1 = viscous + self.lab.dry_friction_N / (np.abs(before) + SLOW)
        d2 = viscous + self.lab.dry_friction_N / (np.abs(before + rate) + SLOW)
        push = (d1 * mu - d2 * (1.0 - mu)) * rate - forces.sum(axis=1)
        self.speed = (mass * self.speed + push) / (mass + d1 + d2)
        self.centre = self.centre + STEP_S * self.speed
        v1 = self.speed - mu * rate
        spring = p["bellows_stiffness"] * (
            p["unstressed_length"] - p["initial_length"] - self.change
        )
        cable = p["rear_mass"] * (v1 - self.v1) / STEP_S + spring - p["bellows_damping"] * rate
        cable += d1 * v1 + forces[:, 0]
        self.v1 = v1
        self.power = p["idle_power"] + p["power_factor"] * np.maximum(-cable * rate, 0.0)


def _parameters(
    truth: Parameters, lab: Lab, count: int, draw: np.random.Generator
) -> dict[str, np.ndarray]:
    found = {}
    for field in fields(truth):
        spread = 0.0 if field.name in NOT_SPREAD else lab.spread
        found[field.name] = getattr(truth, field.name) * np.exp(draw.normal(0.0, spread, count))
    return found
