# SPDX-License-Identifier: Apache-2.0
"""Speed of the simulator and of SciPy's solvers at equal accuracy, and scaling of the simulator."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable
from unittest import mock

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.report import Row, cpu_time, wall_time
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.simulator import evaluate_gait, simulate

TITLE = "a gait against SciPy with located events, batches, growth of the cost"
GAITS = [Gait(0.07, 0.2), Gait(0.0755, 0.15, margin=0.0034), Gait(0.09, 0.4), Gait(0.055, 0.0875)]
ACCURACY = 1e-6  # of power, relative


def scipy_power(gait: Gait, method: str, rtol: float) -> float:
    """Return the mean power (W) over the last three of five cycles by SciPy, with switches at located events."""
    p = PAPER
    forward = gait.direction > 0
    stiffness = (p.engaged_stiffness, p.disengaged_stiffness)
    below, above = stiffness if forward else stiffness[::-1]
    omega = 2.0 * math.pi * gait.frequency
    half_stroke, half = 0.5 * gait.stroke, 0.5 * p.clearance
    threshold = p.switching_threshold + gait.margin
    mass, eta, slack = p.mass, p.viscous_friction, p.slack

    def fin(z: float) -> float:
        return above * (z - half) if z > half else below * (z + half) if z < -half else 0.0

    def rates(t: float, s: np.ndarray, rear: float, front: float) -> tuple[float, ...]:
        x1, v1, change, _ = s
        cosine = math.cos(omega * t)
        u = -half_stroke * (1.0 - cosine)
        slope = 0.0
        if u < -slack:
            slope = -half_stroke * omega * math.sin(omega * t)
        else:
            u = -slack
        rate = (p.gain * u - change) / p.time_constant
        bend = (p.gain * slope - rate) / p.time_constant
        f1, f2 = fin(x1 - rear), fin(x1 + p.initial_length + change - front)
        a1 = (-2.0 * eta * v1 - f1 - f2 - eta * rate - p.front_mass * bend) / mass
        force = p.rear_mass * a1 + p.bellows_stiffness * (
            p.unstressed_length - p.initial_length - change
        )
        force += eta * v1 + f1 - p.bellows_damping * rate
        return v1, a1, rate, max(-force * rate, 0.0)

    events: list[Callable[..., float]] = [
        lambda _t, s, rear, _front: s[0] - rear - threshold,
        lambda _t, s, rear, _front: -threshold - s[0] + rear,
        lambda _t, s, _rear, front: s[0] + p.initial_length + s[2] - front - threshold,
        lambda _t, s, _rear, front: -threshold - s[0] - p.initial_length - s[2] + front,
    ]
    for event in events:
        event.terminal, event.direction = True, 1.0  # type: ignore[attr-defined]
    anchors = [0.0, round(p.initial_length / p.pitch) * p.pitch]
    state, t, work = np.zeros(4), 0.0, []
    for end in (2.0 * gait.period, 5.0 * gait.period):
        while t < end:
            solution = solve_ivp(
                rates, (t, end), state, method, events=events, args=tuple(anchors),
                rtol=rtol, atol=rtol * 1e-3, max_step=0.1 * gait.period,
            )  # fmt: skip
            t, state = float(solution.t[-1]), solution.y[:, -1]
            for k, times in enumerate(solution.t_events):
                if times.size:
                    anchors[k // 2] += p.pitch if k % 2 == 0 else -p.pitch
        work.append(state[3])
    return p.idle_power + p.power_factor * (work[1] - work[0]) * gait.frequency / 3.0


def _tolerance_for(gait: Gait, method: str) -> tuple[float, float]:
    """Return (largest tolerance with which the solver's power is accurate, its error)."""
    exact = evaluate_gait(gait).power
    for rtol in 10.0 ** np.arange(-4.0, -12.0, -1.0):
        error = abs(scipy_power(gait, method, float(rtol)) / exact - 1.0)
        if error <= ACCURACY:
            return float(rtol), error
    return float(rtol), error


def _against_scipy(method: str, goal: str) -> Row:
    ratios = [_ratio(gait, method) for gait in GAITS]
    return Row(
        f"a gait, times faster than {method}",
        f"{min(ratios):,.0f} to {max(ratios):,.0f}",
        goal,
        f"processor time, four gaits, {method} at its loosest tolerance within {ACCURACY:g} of power",
    )


def _ratio(gait: Gait, method: str, count: int = 512) -> float:
    rtol, _ = _tolerance_for(gait, method)
    slow = cpu_time(lambda: scipy_power(gait, method, rtol), 3)
    # a batch of one gait many times: what a gait costs without the call from Python
    strokes = np.full(count, gait.stroke)
    fast = cpu_time(lambda: evaluate_gaits(strokes, gait.frequency, gait.margin, gait.direction), 5)
    return slow / (fast / count)


def _box(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform(0.01, 0.09, count), rng.uniform(0.08, 0.4, count)


def _per_gait() -> Row:
    stroke, frequency = _box(4096)
    spent = cpu_time(lambda: evaluate_gaits(stroke, frequency), 7) / stroke.size
    return Row(
        "a gait of the box, one core",
        f"{spent * 1e6:.1f} µs",
        "15 µs",
        "processor time, 4096 gaits",
    )


def _cores() -> Row:
    stroke, frequency = _box(16384)
    wall = wall_time(lambda: evaluate_gaits(stroke, frequency), 3)
    spent = cpu_time(lambda: evaluate_gaits(stroke, frequency), 3)
    return Row(
        "cores kept busy by a batch",
        f"{spent / wall:.2f}",
        f"{os.cpu_count()}",
        "processor time over clock",
    )


def _scaling() -> list[Row]:
    """Measure the same batch with 1 to all workers.

    The shortest of several durations counts, because other programs only add to it.
    """
    stroke, frequency = _box(65536)
    rows: list[Row] = []
    rates: list[float] = []
    for workers in range(1, (os.cpu_count() or 1) + 1):
        with mock.patch("worm_model.simulation.batch.os.cpu_count", return_value=workers):
            seconds = min(wall_time(lambda: evaluate_gaits(stroke, frequency), 1) for _ in range(5))
        rates.append(stroke.size / seconds)
        value = f"{rates[-1]:,.0f} gaits/s, {rates[-1] / rates[0]:.2f} times one worker"
        rows.append(
            Row(f"a batch over {workers} worker(s)", value, f"{workers} times", "by the clock")
        )
    return rows


def _growth() -> list[Row]:
    stroke, frequency = _box(1024)
    few = cpu_time(lambda: evaluate_gaits(stroke, frequency, cycles=5), 5)
    more = cpu_time(lambda: evaluate_gaits(stroke, frequency, cycles=50), 3)
    many = cpu_time(lambda: evaluate_gaits(*_box(10240)), 3)
    return [
        Row(
            "ten times the cycles cost",
            f"{more / few:.1f} times",
            "at most linear",
            "5 and 50 cycles",
        ),
        Row(
            "ten times the gaits cost",
            f"{many / few:.1f} times",
            "linear",
            "1,024 and 10,240 gaits",
        ),
    ]


def _dense_output() -> Row:
    trajectory = simulate(Gait(0.07, 0.2))
    times = np.linspace(0.0, trajectory.duration, 25_000)
    spent = cpu_time(lambda: trajectory.at(times), 5)
    return Row(
        "dense output",
        f"{times.size / spent / 1e6:.1f} million samples/s",
        "",
        "25,000 samples of a gait",
    )


def _start_up() -> Row:
    def run(*code: str) -> None:
        subprocess.run([sys.executable, "-c", *code], check=True, stdout=subprocess.DEVNULL)

    evaluate = (
        "import sys; from worm_model.commands.evaluate_gait import main; "
        "sys.argv = ['evaluate_gait', '--stroke', '0.07', '--frequency', '0.2']; sys.exit(main())"
    )
    run(evaluate)  # fills the cache
    whole = wall_time(lambda: run(evaluate), 5)
    imports = wall_time(lambda: run("import numpy, numba, yaml"), 5)
    return Row(
        "evaluate_gait beyond Python and its imports",
        f"{whole - imports:.2f} s",
        "0.5 s",
        f"of {whole:.2f} s by the clock; numpy, numba and yaml alone take {imports:.2f} s",
    )


def run() -> list[Row]:
    """Measure."""
    return [
        _against_scipy("LSODA", "3,000"),
        _against_scipy("DOP853", ""),
        _per_gait(),
        _cores(),
        *_scaling(),
        *_growth(),
        _dense_output(),
        _start_up(),
    ]
