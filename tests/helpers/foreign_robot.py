# SPDX-License-Identifier: Apache-2.0
"""Robot that the model does not contain, integrated step by step and independently of worm_model.

Two free masses are joined by a bellows and by a compliant cable that cannot push. A servo with delay and lag drives the
cable through a transmission with backlash. The fins have hysteresis, the modules Stribeck friction, and the pitch and
the threshold vary from groove to groove. So the body length depends on the fins, and a fast gait extends the body only
as far as the bellows pushes it. SI units; forward is +x; contraction is negative.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numba import njit
from recorded_run import EPOCH as EPOCH
from recorded_run import make_run

from worm_model.gait import Gait
from worm_model.run import Run

STEP_S = 1e-4
REST_S, AFTER_S = 2.0, 1.0
COMMAND_HZ, POWER_HZ = 100, 100
GROOVES = 512


@dataclass(frozen=True)
class ForeignRobot:
    """Robot and pipe. The defaults are near the paper's table where the paper has such a quantity."""

    mass: float = 0.43  # kg, of each module
    free_length: float = 0.300
    initial_length: float = 0.2952
    bellows_stiffness: float = 968.8
    bellows_damping: float = 862.4
    viscous_friction: float = 80.0
    cable_stiffness: float = 6400.0  # N/m
    slack: float = 0.008  # m, which the cable takes up in its first contraction
    delay_s: float = 0.03
    lag_s: float = 0.04
    backlash: float = 0.0006  # m of cable
    coulomb: float = 0.3  # N, of each module
    breakaway: float = 0.5  # N
    stribeck_speed: float = 0.004  # m/s
    engaged_stiffness: float = 1833.1
    disengaged_stiffness: float = 442.0
    clearance: float = 0.00753
    hysteresis_N: float = 0.3  # of each fin
    threshold: float = 0.0175
    threshold_scatter: float = 0.0002
    rear_excess: float = 0.0  # m, added to the threshold of the rear fin in every groove
    front_excess: float = 0.0
    pitch: float = 0.0173
    pitch_scatter: float = 0.015  # relative, from groove to groove
    idle_power: float = 0.82
    power_factor: float = 3.2
    pipe: int = 0  # seed of the grooves

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the positions and the thresholds of the grooves, shape (GROOVES,); x1 begins in the middle one."""
        random = np.random.default_rng([self.pipe, 7])
        pitches = self.pitch * (1.0 + self.pitch_scatter * random.standard_normal(GROOVES))
        places = np.cumsum(pitches)
        thresholds = self.threshold + self.threshold_scatter * random.standard_normal(GROOVES)
        return places - places[GROOVES // 2], thresholds


@dataclass(frozen=True)
class Camera:
    """Instruments: frame rate, noise of a position (m) and of the power (W), delay of the frames (s)."""

    rate_hz: float = 30.0
    noise_m: float = 0.00025
    power_noise_W: float = 0.05
    delay_s: float = 0.0


@dataclass(frozen=True)
class ForeignRun:
    """True motion (n,) each ms from the onset, and the recording of the instruments."""

    time: np.ndarray
    rear: np.ndarray
    front: np.ndarray
    rear_groove: np.ndarray
    front_groove: np.ndarray
    cable_force: np.ndarray
    run: Run

    def grooves(self, cycles: int, frequency: float) -> np.ndarray:
        """Return the grooves that the rear fin gains in each cycle (cycles,), from one start of a cycle to the next."""
        starts = np.searchsorted(self.time, np.arange(cycles + 1) / frequency)
        return np.diff(self.rear_groove[np.minimum(starts, self.time.size - 1)])


def some_robot(seed: int, **changes: float) -> ForeignRobot:
    """Return a robot whose values differ from the defaults by some percent, in a pipe of its own."""
    random = np.random.default_rng([seed, 3])

    def about(value: float, share: float) -> float:
        return float(value * np.exp(share * random.standard_normal()))

    usual = ForeignRobot()
    robot = ForeignRobot(
        bellows_stiffness=about(usual.bellows_stiffness, 0.04),
        bellows_damping=about(usual.bellows_damping, 0.05),
        viscous_friction=about(usual.viscous_friction, 0.1),
        cable_stiffness=about(usual.cable_stiffness, 0.15),
        slack=about(usual.slack, 0.05),
        delay_s=about(usual.delay_s, 0.3),
        backlash=about(usual.backlash, 0.3),
        coulomb=about(usual.coulomb, 0.3),
        engaged_stiffness=about(usual.engaged_stiffness, 0.04),
        disengaged_stiffness=about(usual.disengaged_stiffness, 0.04),
        clearance=about(usual.clearance, 0.03),
        threshold=about(usual.threshold, 0.01),
        pipe=seed,
    )
    return dataclasses.replace(robot, **changes)


def crawl(
    robot: ForeignRobot, gait: Gait, cycles: int = 5, camera: Camera = Camera(), seed: int = 0
) -> ForeignRun:
    """Return a forward run of a gait: a rest, the cycles, and a second at rest."""
    duration = cycles * gait.period + AFTER_S
    time = np.arange(-REST_S, duration, STEP_S)
    command = np.where((time > 0.0) & (time < cycles * gait.period), gait.command(time), 0.0)
    begin = np.clip(
        2.0 * (time + REST_S) / REST_S, 0.0, 1.0
    )  # tensioned in the first half of the rest
    command = np.where(time <= 0.0, gait.point_of_rest * begin, command)
    command = np.where(time >= cycles * gait.period, gait.point_of_rest, command)
    delayed = command[np.maximum(np.arange(time.size) - round(robot.delay_s / STEP_S), 0)]
    places, thresholds = robot.places()
    fins = thresholds + robot.rear_excess, thresholds + robot.front_excess
    motion = _integrate(_values(robot), places, *fins, delayed)
    return ForeignRun(
        *_after_onset(time, motion),
        _recording(gait, cycles, time, command, motion, robot, camera, seed),
    )


def _values(robot: ForeignRobot) -> tuple[float, ...]:
    names = [each.name for each in dataclasses.fields(robot)]
    return tuple(float(getattr(robot, name)) for name in names[: names.index("threshold")])


def _after_onset(time: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, ...]:
    every = slice(np.searchsorted(time, 0.0), None, round(1e-3 / STEP_S))
    rear, front, rear_groove, front_groove, force, _ = motion[:, every]
    return time[every], rear, front, rear_groove, front_groove, force


@njit(cache=True)
def _fin(x, v, place, half, stiff, soft, hysteresis, bend, h):
    """Return (force on the module towards -x, hysteresis force) of a forward fin at a deflection."""
    deflection = x - place
    force = 0.0
    if deflection > half:
        force = soft * (deflection - half)
    elif deflection < -half:
        force = stiff * (deflection + half)
    if force == 0.0 or hysteresis == 0.0:
        return force, 0.0
    sign = 1.0 if v > 0.0 else -1.0
    bend += 3000.0 * (1.0 - bend * sign / hysteresis) * v * h  # Dahl's model
    return force + bend, bend


@njit(cache=True)
def _integrate(values, places, rear_thresholds, front_thresholds, command):
    (mass, free, initial, kb, cb, eta, kc, slack, _delay, lag, backlash, coulomb, breakaway, stribeck,
     stiff, soft, clearance, hysteresis) = values  # fmt: skip
    h, half = STEP_S, 0.5 * clearance
    out = np.empty((6, command.size))
    start = places.size // 2
    rear = start
    front = start + int(np.argmin(np.abs(places[start:] - initial)))
    x1, x2, v1, v2 = 0.0, initial, 0.0, 0.0
    servo = spool = 0.0
    bend1 = bend2 = 0.0
    taken = False
    preload = kb * (free - initial)
    for k in range(command.size):
        before = spool
        servo += (command[k] - servo) * h / lag
        spool = min(max(spool, servo - 0.5 * backlash), servo + 0.5 * backlash)
        taken = taken or spool < -slack
        pulled = min(spool, -slack) if taken else spool
        tension = max(preload + kc * (x2 - x1 - initial - pulled), 0.0)
        inner = tension + kb * (x2 - x1 - free) + cb * (v2 - v1)
        if x1 - places[rear] > rear_thresholds[rear]:
            rear, bend1 = rear + 1, 0.0
        elif x1 - places[rear] < -rear_thresholds[rear]:
            rear, bend1 = rear - 1, 0.0
        if x2 - places[front] > front_thresholds[front]:
            front, bend2 = front + 1, 0.0
        elif x2 - places[front] < -front_thresholds[front]:
            front, bend2 = front - 1, 0.0
        f1, bend1 = _fin(x1, v1, places[rear], half, stiff, soft, hysteresis, bend1, h)
        f2, bend2 = _fin(x2, v2, places[front], half, stiff, soft, hysteresis, bend2, h)
        d1 = (coulomb + (breakaway - coulomb) * np.exp(-((v1 / stribeck) ** 2))) * np.tanh(
            v1 / 2e-4
        )
        d2 = (coulomb + (breakaway - coulomb) * np.exp(-((v2 / stribeck) ** 2))) * np.tanh(
            v2 / 2e-4
        )
        v1 += h / mass * (inner - eta * v1 - d1 - f1)
        v2 += h / mass * (-inner - eta * v2 - d2 - f2)
        x1 += h * v1
        x2 += h * v2
        out[0, k], out[1, k], out[2, k], out[3, k], out[4, k] = x1, x2, rear, front, tension
        out[5, k] = max(-tension * (spool - before) / h, 0.0)
    return out


def _recording(
    gait: Gait,
    cycles: int,
    time: np.ndarray,
    command: np.ndarray,
    motion: np.ndarray,
    robot: ForeignRobot,
    camera: Camera,
    seed: int,
) -> Run:
    random = np.random.default_rng([seed, robot.pipe, 11])

    def sampled(values: np.ndarray, at: np.ndarray) -> np.ndarray:
        return np.interp(at, time, values)

    frames = np.arange(-REST_S, time[-1], 1.0 / camera.rate_hz)
    noise = random.normal(0.0, camera.noise_m, (2, frames.size))
    rear, front = (sampled(motion[k], frames - camera.delay_s) + noise[k] for k in range(2))
    commands = np.arange(-REST_S, time[-1], 1.0 / COMMAND_HZ)
    readings = np.arange(-REST_S, time[-1], 1.0 / POWER_HZ)
    watts = robot.idle_power + robot.power_factor * sampled(motion[5], readings)
    watts += random.normal(0.0, camera.power_noise_W, readings.size)
    return make_run(
        gait,
        0.0,
        (frames, rear, front),
        (commands, sampled(command, commands)),
        (readings, watts),
        cycles=cycles,
        end=cycles * gait.period,
    )
