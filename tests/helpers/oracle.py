# SPDX-License-Identifier: Apache-2.0
"""Independent integration of the model, the oracle of the simulator's tests and benchmark.

It shares no formula with the kernel. It integrates the literal reduced dynamics in x1 (eq:continuous_model) with SciPy,
with the first and second derivative of the length. The actuation lag and the positive cable work are states. Every
border, threshold and sign change is a located, terminal event. Dry friction is Coulomb's inclusion: a module slides or
sticks until its own event. After rest it has the only acceleration that satisfies the inclusion. Nothing is
regularised.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from worm_model.gait import Gait
from worm_model.parameters import Parameters

OPTIONS = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-13}  # of SciPy's solve_ivp, with atol in m
SETTLING_S = 1e-9  # after an event, in which its border cannot be passed again
ROUNDING_N = 1e-9  # force beyond its dry friction that still holds a module that creeps to rest


@dataclass
class OracleRun:
    """Result of the oracle: x1 (m) and cable work (J) at the start of every cycle and at the end, and samples."""

    switches: int = 0
    boundaries: list[tuple[float, float]] = field(default_factory=list)
    switch_times: list[float] = field(default_factory=list)
    times: list[np.ndarray] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)

    def advance(self, averaged: int) -> float:
        return (self.boundaries[-1][0] - self.boundaries[-1 - averaged][0]) / averaged

    def work(self, averaged: int) -> float:
        return (self.boundaries[-1][1] - self.boundaries[-1 - averaged][1]) / averaged


@dataclass(frozen=True)
class _Discrete:
    """Anchors in m, the region of each fin (−1, 0, 1), and the signs that the power depends on.

    ``slides`` is the sign of each module's velocity, 0 where dry friction holds it.
    """

    anchors: tuple[float, float]
    regions: tuple[int, int]
    slides: tuple[int, int] = (0, 0)
    force_sign: float = 1.0
    rate_sign: float = 1.0


class Oracle:
    """Model of one gait."""

    def __init__(self, gait: Gait, parameters: Parameters) -> None:
        self.gait, self.p = gait, parameters
        self.threshold = parameters.switching_threshold + gait.margin
        self.half = 0.5 * parameters.clearance
        self.cosine = gait.profile.name == "COSINE"
        self.dry = parameters.rear_dry_friction, parameters.front_dry_friction
        self.mass = parameters.rear_mass + parameters.front_mass
        self.load = parameters.rear_load + parameters.front_load

    def command(self, time: float, clipped: bool) -> tuple[float, float]:
        """Return u_eff and its derivative."""
        if clipped:
            return -self.p.slack, 0.0
        return self.unclipped(float(time))

    def unclipped(self, time: float) -> tuple[float, float]:
        """Return u_cmd and its derivative."""
        gait = self.gait
        phase, share = time * gait.frequency % 1.0, gait.contraction_share
        if phase < share:
            drawn, rate = self.drawn(phase / share)
            duration = share / gait.frequency
        else:
            drawn, rate = self.drawn((1.0 - phase) / (1.0 - share))  # reversed in time
            duration = -(1.0 - share) / gait.frequency
        return -gait.pretension - gait.stroke * drawn, -gait.stroke * rate / duration

    def drawn(self, part: float) -> tuple[float, float]:
        """Return g and its derivative after a fraction of a half."""
        if self.cosine:
            return 0.5 - 0.5 * math.cos(math.pi * part), 0.5 * math.pi * math.sin(math.pi * part)
        ramp = self.gait.ramp_share
        top = 1.0 / (1.0 - ramp)
        speed = top * min(1.0, part / ramp, (1.0 - part) / ramp)
        if part < ramp:
            return 0.5 * part * speed, speed
        if part <= 1.0 - ramp:
            return 0.5 * ramp * top + (part - ramp) * top, speed
        return 1.0 - 0.5 * (1.0 - part) * speed, speed

    def fin_force(self, displacement: float, region: int) -> float:
        if region == 0:
            return 0.0
        stiff = region == (-1 if self.gait.direction > 0 else 1)
        stiffness = self.p.engaged_stiffness if stiff else self.p.disengaged_stiffness
        return stiffness * (displacement - region * self.half)

    def rates(self, time: float, state: np.ndarray, clipped: bool, d: _Discrete) -> list[float]:
        x1, v1, length_change, _ = state.tolist()  # Python computes faster with its own floats
        u, u_rate = self.command(time, clipped)
        rate = (self.p.gain * u - length_change) / self.p.time_constant
        acceleration = (self.p.gain * u_rate - rate) / self.p.time_constant
        rear = self.fin_force(x1 - d.anchors[0], d.regions[0])
        front = self.fin_force(
            x1 + self.p.initial_length + length_change - d.anchors[1], d.regions[1]
        )
        load = (
            -2.0 * self.p.viscous_friction * v1
            - rear
            - front
            - self.p.viscous_friction * rate
            - self.p.front_mass * acceleration
            - self.load
        )
        sliding = self.dry[0] * d.slides[0], self.dry[1] * d.slides[1]
        a1 = (load - sliding[0] - sliding[1]) / self.mass
        if self.dry[0] > 0.0 and d.slides[0] == 0:
            a1 = 0.0
        elif self.dry[1] > 0.0 and d.slides[1] == 0:
            a1 = -acceleration
        held = load - self.mass * a1  # held by the dry friction of both
        holds = held - sliding[1], held - sliding[0]
        self._seen = load, acceleration, rate, holds
        force = (
            self.p.rear_mass * a1
            + self.p.bellows_stiffness
            * (self.p.unstressed_length - self.p.initial_length - length_change)
            - self.p.bellows_damping * rate
            + self.p.viscous_friction * v1
            + rear
            + self.p.rear_load
            + (sliding[0] if d.slides[0] or self.dry[0] == 0.0 else holds[0])
        )
        billed = -force * rate if d.force_sign * d.rate_sign < 0.0 else 0.0
        if self.p.one_sided_cable and d.force_sign < 0.0:
            billed = 0.0
        self._last = force, rate
        return [v1, a1, rate, billed]

    def signs(self, time: float, state: np.ndarray, clipped: bool, d: _Discrete) -> _Discrete:
        nudge = 1e-9
        ahead = state + nudge * np.array(self.rates(time, state, clipped, d))
        self.rates(time + nudge, ahead, clipped, d)
        force, rate = self._last
        return replace(d, force_sign=math.copysign(1.0, force), rate_sign=math.copysign(1.0, rate))

    def grip(self, time: float, state: np.ndarray, clipped: bool, d: _Discrete) -> _Discrete:
        """Return how dry friction acts from now on; a module without dry friction "slides" forward."""
        at_rest = tuple(
            dry > 0.0 and side == 0 for dry, side in zip(self.dry, d.slides, strict=True)
        )
        if not any(at_rest):
            return d
        self.rates(time, state, clipped, d)
        load, acceleration, _, _ = self._seen
        turning = (0.0, -acceleration)  # ẍ1 with which a module at rest stays at rest

        def surplus(a: float) -> float:
            """Return inertia plus friction minus the load, ascending in the acceleration of the rear module."""
            total = self.mass * a - load
            for fin in (0, 1):
                side = np.sign(a - turning[fin]) if at_rest[fin] else d.slides[fin]
                total += self.dry[fin] * side
            return total

        tiny = 1e-12 * (1.0 + abs(acceleration))
        for fin in (0, 1):
            if at_rest[fin] and surplus(turning[fin] - tiny) < 0.0 < surplus(turning[fin] + tiny):
                sides = [int(np.sign(turning[fin] - turning[k])) for k in (0, 1)]
                break
        else:
            low, high = -1e9, 1e9
            for _ in range(200):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if surplus(middle) < 0.0 else (low, middle)
            sides = [int(np.sign(0.5 * (low + high) - turning[k])) for k in (0, 1)]
        return replace(d, slides=tuple(sides[k] if at_rest[k] else d.slides[k] for k in (0, 1)))

    def grip_gaps(self, clipped: bool, d: _Discrete) -> list[tuple[int, Callable[..., float]]]:
        """Return (module, function that falls through zero when its friction state changes) for each module."""

        def velocity(fin: int, time: float, state: np.ndarray) -> float:
            self.rates(time, state, clipped, d)
            return state[1] + fin * self._seen[2]

        def spare(fin: int, time: float, state: np.ndarray) -> float:
            self.rates(time, state, clipped, d)
            return self.dry[fin] + ROUNDING_N - abs(self._seen[3][fin])

        found = []
        for fin in (0, 1):
            side = d.slides[fin]
            if self.dry[fin] > 0.0 and side:
                found.append((fin, lambda t, s, fin=fin, side=side: side * velocity(fin, t, s)))
            elif self.dry[fin] > 0.0:
                found.append((fin, lambda t, s, fin=fin: spare(fin, t, s)))
        return found

    def at_rest(
        self, module: int, time: float, state: np.ndarray, clipped: bool, d: _Discrete
    ) -> tuple[np.ndarray, _Discrete]:
        """Return the state and the discrete state when a module comes to rest; `grip` decides what follows."""
        self.rates(time, state, clipped, d)
        rest = state.copy()
        rest[1] = 0.0 if module == 0 or self._rests(0, d) else -self._seen[2]
        return rest, replace(d, slides=(0, d.slides[1]) if module == 0 else (d.slides[0], 0))

    def _rests(self, module: int, d: _Discrete) -> bool:
        return self.dry[module] > 0.0 and d.slides[module] == 0

    def gaps(self, clipped: bool, d: _Discrete) -> list[Callable[..., float]]:
        """Return functions that fall through zero at an event: rear high, low, front high, low, signs."""

        def displacement(fin: int, state: np.ndarray) -> float:
            if fin == 0:
                return state[0] - d.anchors[0]
            return state[0] + self.p.initial_length + state[2] - d.anchors[1]

        def quantity(index: int, time: float, state: np.ndarray) -> float:
            self.rates(time, state, clipped, d)
            return self._last[index]

        functions: list[Callable[..., float]] = []
        for fin in (0, 1):
            low, high = _borders(d.regions[fin], self.half, self.threshold)
            functions.append(lambda t, s, fin=fin, high=high: high - displacement(fin, s))
            functions.append(lambda t, s, fin=fin, low=low: displacement(fin, s) - low)
        functions.append(lambda t, s: d.force_sign * quantity(0, t, s))
        if not clipped:  # a mere decay keeps its sign
            functions.append(lambda t, s: d.rate_sign * quantity(1, t, s))
        return functions

    def apply(self, event: int, d: _Discrete) -> tuple[_Discrete, bool]:
        """Return the discrete state after an event, and whether an anchor switched."""
        if event == 4:
            return replace(d, force_sign=-d.force_sign), False
        if event == 5:
            return replace(d, rate_sign=-d.rate_sign), False
        fin, direction = event // 2, 1 if event % 2 == 0 else -1
        anchors, regions = list(d.anchors), list(d.regions)
        switched = regions[fin] == direction
        if switched:
            anchors[fin] += direction * self.p.pitch
            landing = direction * (self.threshold - self.p.pitch)
            regions[fin] = _region(landing, self.half)
        elif self.half == 0.0:  # no clearance: directly from one bar to the other
            regions[fin] = direction
        else:
            regions[fin] += direction
        return replace(d, anchors=tuple(anchors), regions=tuple(regions)), switched

    def segments(self, cycles: int) -> list[tuple[float, float, bool]]:
        """Yield (start, end, clipped) in time order, between the times at which the waveform changes its form."""
        period, share, ramp = (
            1.0 / self.gait.frequency,
            self.gait.contraction_share,
            self.gait.ramp_share,
        )
        knots = {0.0, share * period, period}
        if self.gait.profile.name == "TRAPEZOID":
            knots |= {period * share * part for part in (ramp, 1.0 - ramp)}
            knots |= {period * (share + (1.0 - share) * part) for part in (ramp, 1.0 - ramp)}

        def beyond(time: float) -> float:
            return -self.p.slack - self.unclipped(time)[0]

        if beyond(share * period) > 0.0 > beyond(0.0):
            knots |= {brentq(beyond, 0.0, share * period, xtol=1e-15)}
            knots |= {brentq(beyond, share * period, period * (1.0 - 1e-15), xtol=1e-15)}
        return [
            (k * period + start, k * period + end, beyond(0.5 * (start + end)) < 0.0)
            for k in range(cycles)
            for start, end in pairwise(sorted(knots))
        ]

    def start(self) -> tuple[np.ndarray, _Discrete]:
        """Return the start at rest.

        Under a load it is where the fins balance it; fins beyond their threshold are one groove further.
        """
        pitch, tense = self.p.pitch, self.gait.pretension > 0.0
        change = -self.p.gain * max(self.gait.pretension, self.p.slack) if tense else 0.0
        length = self.p.initial_length + change
        anchors = [0.0, pitch * math.ceil(self.p.initial_length / pitch - 0.5 - 1e-12)]

        def pushed(x1: float) -> float:
            deflections = x1 - anchors[0], x1 + length - anchors[1]
            fins = sum(self.fin_force(x, _region(x, self.half)) for x in deflections)
            return fins + self.load

        for _ in range(30):
            x1 = 0.0 if self.load == 0.0 else brentq(pushed, -10.0, 10.0, xtol=1e-16)
            deflections = x1 - anchors[0], x1 + length - anchors[1]
            over = [fin for fin in (0, 1) if abs(deflections[fin]) > self.threshold]
            if not over:
                break
            anchors[over[0]] += math.copysign(pitch, deflections[over[0]])
        else:
            raise ValueError("the fins do not hold the load")
        regions = tuple(_region(x, self.half) for x in deflections)
        slides = 0 if self.dry[0] else 1, 0 if self.dry[1] and tense else -1
        # without pretension, ΔL starts at once with a rate
        return np.array([x1, 0.0, change, 0.0]), _Discrete(tuple(anchors), regions, slides)

    def run(self, cycles: int = 5, samples: np.ndarray | None = None) -> OracleRun:
        """Integrate the cycles from the start; ``samples`` are times at which the state is stored."""
        out = OracleRun()
        period = 1.0 / self.gait.frequency
        state, d = self.start()
        for start, end, clipped in self.segments(cycles):
            if abs(start / period - round(start / period)) < 1e-9:
                out.boundaries.append((state[0], state[3]))
            state, d = self._segment(start, end, clipped, state, d, samples, out)
        out.boundaries.append((state[0], state[3]))
        return out

    def _segment(self, start, end, clipped, state, d, samples, out):  # type: ignore[no-untyped-def]
        time = start
        while time < end:
            d = self.grip(time, state, clipped, d)
            d = self.signs(time, state, clipped, d)
            solution = self._solve(time, end, clipped, state, d)
            reached = float(solution.t[-1])
            if samples is not None:
                inside = samples[(samples > time) & (samples <= reached)]
                out.times.append(inside)
                out.states.append(solution.sol(inside) if inside.size else np.empty((4, 0)))
            hits = [k for k, times in enumerate(solution.t_events) if times.size]
            if not hits:
                state = solution.y[:, -1]
                break
            event = hits[0]
            time, state = solution.t_events[event][0], solution.y_events[event][0]
            of_fins_and_signs = len(self.gaps(clipped, d))
            if event >= of_fins_and_signs:
                module = self.grip_gaps(clipped, d)[event - of_fins_and_signs][0]
                state, d = self.at_rest(module, time, state, clipped, d)
                continue
            d, switched = self.apply(event, d)
            out.switches += switched
            if switched:
                out.switch_times.append(time)
        return state, d

    def _solve(self, time, end, clipped, state, d):  # type: ignore[no-untyped-def]
        """Integrate to the next event, in steps so short that no border is crossed twice unnoticed."""
        gaps = self.gaps(clipped, d)
        grips = [gap for _, gap in self.grip_gaps(clipped, d)]
        for longest in (math.inf, 3e-3, 3e-4, 3e-5):
            solution = solve_ivp(
                lambda t, s: self.rates(t, s, clipped, d),
                (time, end),
                state,
                events=[_from_the_right_side(gap, time) for gap in gaps + grips],
                dense_output=True,
                max_step=longest,
                **OPTIONS,
            )
            times = _within_steps(solution.t)
            states = solution.sol(times)
            overlooked = any(np.min(gap(times, states), initial=0.0) < -1e-11 for gap in gaps[:4])
            overlooked |= any(
                gap(moment, seen) < -1e-9
                for gap in grips
                for moment, seen in zip(times, states.T, strict=True)
                if moment > time + 2.0 * SETTLING_S
            )
            if not overlooked:
                return solution
        raise AssertionError(f"an event was overlooked after {time} s")


def _within_steps(times: np.ndarray) -> np.ndarray:
    """Yield eight times within every step of an integration."""
    steps = np.diff(times)[:, np.newaxis]
    return (times[:-1, np.newaxis] + steps * np.linspace(0.125, 1.0, 8)).ravel()


def _from_the_right_side(gap: Callable[..., float], start: float) -> Callable[..., float]:
    """Return the gap, positive at first:

    rounding can place a state that has just reached a border on its other side.
    """

    def positive_at_first(time: float, state: np.ndarray) -> float:
        found = gap(time, state)
        return max(found, 1e-18) if time < start + SETTLING_S else found

    positive_at_first.terminal, positive_at_first.direction = True, -1.0  # type: ignore[attr-defined]
    return positive_at_first


def _region(displacement: float, half: float) -> int:
    return int(displacement > half) - int(displacement < -half)


def _borders(region: int, half: float, threshold: float) -> tuple[float, float]:
    return {-1: (-threshold, -half), 0: (-half, half), 1: (half, threshold)}[region]
