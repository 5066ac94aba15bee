# SPDX-License-Identifier: Apache-2.0
"""Robots with faults, integrated step by step and independently of worm_model.

Their driver, camera and power sensor provide samples for the twin. Each robot deviates from the twin's parameters and
has dry friction, grooves that differ and noisy instruments. A fault begins in a cycle at a phase. A fin's miss belongs
to the cycle in which x1 falls behind: the front fin's miss happens at the end of the cycle before. SI units; forward is
+x.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from worm_model.parameters import PAPER, Parameters
from worm_model.run import Activity
from worm_model.twin.data.records import Event
from worm_model.twin.data.samples import SampleKind, sample_rows
from worm_model.twin.twin import Output, Twin
from worm_msgs.gait import GAIT_UNITS, Gait

ONSET = 1_700_000_000_000_000_000
STEP_S = 1e-3
REST_S, AFTER_S = 2.0, 1.0
COMMAND_HZ, POWER_HZ = 100, 100
GROOVES = 64
CARRIED_S = 0.5  # duration in which a person moves a robot
EARLY_M = 0.010  # distance by which a fin that gains a groove switches too early
SLOW = 1e-3  # m/s below which dry friction fades
KINDS = (
    "gain",
    "slip",
    "viscous_friction",
    "rear_load",
    "both_loads",
    "robot",
    "gained",
    "rear",
    "front",
    "healthy",
    "scale",  # this and the next change only what the instruments measure
    "offset",
    "camera",
)
GAIN, SLIP, VISCOUS_FRICTION, REAR_LOAD, BOTH_LOADS, ROBOT, GAINED, REAR, FRONT = range(9)


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
    count = len(faults)
    bodies = _bodies(truth, lab, count, draw)
    shape = (count, 2, GROOVES)
    limits = bodies["switching_threshold"][:, None, None] + lab.threshold_m * draw.normal(
        size=shape
    )
    factors = np.maximum(1.0 + lab.stiffness * draw.normal(size=shape), 0.2)
    end = cycles * gait.period
    times = np.arange(-round(REST_S / STEP_S), round((end + AFTER_S) / STEP_S) + 1) * STEP_S
    commands = np.where((times > 0.0) & (times < end), _command(gait, times), 0.0)
    begins = np.array([(fault.cycle - 1 + fault.phase) * gait.period for fault in faults])
    positions, power = np.empty((times.size, count, 2)), np.empty((times.size, count))
    for k, fault in enumerate(faults):
        failing = _Failing(KINDS.index(fault.kind), fault.size, fault.cycle, begins[k])
        setting = _Setting(
            gait.direction,
            gait.period,
            lab.dry_friction_N,
            truth.pitch,
            usual,
            limits[k],
            factors[k],
        )
        _integrate(times, commands, bodies[k], failing, setting, positions[:, k], power[:, k])
    on = times[:, None] >= begins

    def present(kind: str) -> np.ndarray:
        """Return the sizes of the faults of one kind at each step, 0 for the other robots."""
        return on * np.array([fault.size if fault.kind == kind else 0.0 for fault in faults])

    power = power * (1.0 + present("scale")) + present("offset")
    power = power[:: round(1 / POWER_HZ / STEP_S)]
    looks = np.rint(np.arange(0.0, times[-1] - times[0], 1.0 / lab.camera_hz) / STEP_S).astype(int)
    seen = 0.4 + positions[looks] + present("camera")[looks, :, None]
    seen = seen + lab.camera_noise_m * draw.normal(size=seen.shape)
    ends = [round((c * gait.period - times[0]) / STEP_S) for c in range(cycles + 1)]
    return Robots(
        gait,
        cycles,
        times[:: round(1 / COMMAND_HZ / STEP_S)],
        times[looks],
        seen[:, :, 0],
        seen[:, :, 1],
        times[:: round(1 / POWER_HZ / STEP_S)],
        power + lab.power_noise_W * draw.normal(size=power.shape),
        np.rint(np.diff(positions[ends, :, 0], axis=0) / truth.pitch).astype(int),
    )


class _Failing(NamedTuple):
    """Fault of a robot: its kind in `KINDS`, its size and cycle, and the time in s at which it begins."""

    kind: int
    size: float
    cycle: int
    begin: float


class _Setting(NamedTuple):
    """Gait, dry friction, and the grooves (2, GROOVES): thresholds in m and factors of the stiffness."""

    direction: int
    period: float
    dry: float
    pitch: float
    usual: int
    limits: np.ndarray
    factors: np.ndarray


@njit(cache=True)
def _at_fault(
    limit: np.ndarray, phase: float, fault: _Failing, switches: np.ndarray, usual: int
) -> None:
    """Change the thresholds (2,) of a fin that misses its last switch, or switches once too often.

    ``phase`` counts from the fault's cycle.
    """
    of_front = phase + 0.5
    if fault.kind == REAR:
        if 0.0 < phase < fault.size and phase % 1.0 < 0.8 and switches[0] >= usual - 1:
            limit[0] = 1.0
    elif fault.kind == FRONT:
        if 0.0 < of_front < fault.size and of_front % 1.0 < 0.8 and switches[1] >= usual - 1:
            limit[1] = 1.0
    elif fault.kind == GAINED and 0.0 < phase < 0.6 and switches[0] == usual:
        limit[0] -= EARLY_M


@njit(cache=True)
def _switch(
    time: float,
    carried: bool,
    x: np.ndarray,
    fault: _Failing,
    setting: _Setting,
    anchor: np.ndarray,
    stood: np.ndarray,
    switches: np.ndarray,
) -> None:
    """Move anchors on where a fin passes its ridge, and to other grooves where a person puts the robot down."""
    within, step = (time / setting.period) % 1.0, STEP_S / setting.period
    if within < step:
        switches[0] = 0
    elif abs(within - 0.5) < 0.6 * step:
        switches[1] = 0
    limit = np.array([setting.limits[f, anchor[f] % GROOVES] for f in range(2)])
    phase = time / setting.period - (fault.cycle - 1)
    _at_fault(limit, phase, fault, switches, setting.usual)
    down = fault.kind == ROBOT and abs(time - fault.begin - CARRIED_S) < 0.6 * STEP_S
    for f in range(2):
        stretch = x[f] - anchor[f] * setting.pitch
        moves = int(stretch > limit[f]) - int(stretch < -limit[f])
        if down:
            moves = int(np.rint((stretch - stood[f]) / setting.pitch))
        elif carried:
            moves = 0
        anchor[f] += moves
        switches[f] += abs(moves)
        if not carried:
            stood[f] = stretch


@njit(cache=True)
def _set_forces(
    force: np.ndarray,
    carried: bool,
    x: np.ndarray,
    size: float,
    p: Any,
    kind: int,
    setting: _Setting,
    anchor: np.ndarray,
) -> None:
    """Fill the forces (2,) of the fins and the loads, N; ``size`` is that of a present fault."""
    for f in range(2):
        s = 0.0 if carried else x[f] - anchor[f] * setting.pitch
        beyond = np.sign(s) * max(abs(s) - 0.5 * p.clearance, 0.0)
        held = setting.direction * s < 0.0
        stiffness = p.engaged_stiffness if held else p.disengaged_stiffness
        fin = stiffness * setting.factors[f, anchor[f] % GROOVES] * beyond
        own = p.front_load if f == 1 else p.rear_load + (size if kind == REAR_LOAD else 0.0)
        force[f] = fin + own + (0.5 * size if kind == BOTH_LOADS else 0.0)


@njit(cache=True)
def _integrate(
    times: np.ndarray,
    commands: np.ndarray,
    p: Any,
    fault: _Failing,
    setting: _Setting,
    positions: np.ndarray,
    powers: np.ndarray,
) -> None:
    """Integrate one robot, a row ``p`` of parameters, and fill the position (n, 2) and source power (n,) of each step.

    The command, in m, is that of each step.
    """
    kind, pitch = fault.kind, setting.pitch
    mu = p.front_mass / (p.rear_mass + p.front_mass)
    mass = (p.rear_mass + p.front_mass) / STEP_S
    decay = np.exp(-STEP_S / p.time_constant)
    change = centre = speed = v1 = 0.0
    taut = False
    anchor = np.array([0, int(np.rint(p.initial_length / pitch))])
    x, stood, force = np.zeros(2), np.zeros(2), np.zeros(2)
    switches = np.zeros(2, np.int64)
    for k in range(times.size):
        time = times[k]
        on = time >= fault.begin
        size = fault.size if on else 0.0

        taut = taut or commands[k] < -5e-5
        pulled = min(commands[k] + (size if kind == SLIP else 0.0), -p.slack if taut else 0.0)
        goal = p.gain * (1.0 + (size if kind == GAIN else 0.0)) * pulled
        change = goal + (change - goal) * decay
        rate = (goal - change) / p.time_constant
        carried = kind == ROBOT and on and time < fault.begin + CARRIED_S
        if carried:
            centre += size * pitch * STEP_S / CARRIED_S
        x[0] = centre - mu * change
        x[1] = x[0] + p.initial_length + change
        positions[k] = x

        _switch(time, carried, x, fault, setting, anchor, stood, switches)
        _set_forces(force, carried, x, size, p, fault.kind, setting, anchor)

        # implicit friction
        before = speed - mu * rate
        viscous = p.viscous_friction * (1.0 + (size if kind == VISCOUS_FRICTION else 0.0))
        d1 = viscous + setting.dry / (abs(before) + SLOW)
        d2 = viscous + setting.dry / (abs(before + rate) + SLOW)
        push = (d1 * mu - d2 * (1.0 - mu)) * rate - (force[0] + force[1])
        speed = (mass * speed + push) / (mass + d1 + d2)
        centre += STEP_S * speed
        earlier, v1 = v1, speed - mu * rate
        spring = p.bellows_stiffness * (p.unstressed_length - p.initial_length - change)
        cable = p.rear_mass * (v1 - earlier) / STEP_S + spring - p.bellows_damping * rate
        cable += d1 * v1 + force[0]
        powers[k] = p.idle_power + p.power_factor * max(-cable * rate, 0.0)


def _bodies(truth: Parameters, lab: Lab, count: int, draw: np.random.Generator) -> np.recarray:
    """Return the parameters of each robot as a row."""
    columns = {}
    for name, value in asdict(truth).items():
        spread = 0.0 if name in NOT_SPREAD else lab.spread
        columns[name] = value * np.exp(draw.normal(0.0, spread, count))
    return np.rec.fromarrays(list(columns.values()), names=list(columns))


def followed(rows: np.ndarray, parameters: Parameters = PAPER) -> Output:
    """Return the output of a twin for all samples at once."""
    twin = Twin(parameters)
    return twin.advance(twin.start(), rows, to_the_end=True)


def causes(rows: np.ndarray) -> list[Event]:
    """Return the twin's events that name a cause."""
    return [event for event in followed(rows).events if event.code]
