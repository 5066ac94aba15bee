# SPDX-License-Identifier: Apache-2.0
"""Hybrid simulator: from a gait, or any length signal, to the motion and power of the robot.

The simulator is exact and has no step size, because between events all quantities have closed forms, and each event is
located. `evaluate_gait` returns the results of a gait and `simulate` its trajectory. `Locomotion` follows a measured or
estimated length. `worm_model.simulation.batch` evaluates many gaits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.arrays import Array
from worm_model.errors import InputError
from worm_model.gait import AVERAGED, CYCLES, FORWARD, Gait, check_body
from worm_model.parameters import PAPER, Parameters
from worm_model.simulation.closed_form import front_groove, groove_phase, largest_static_load
from worm_model.simulation.kernel import guard, march
from worm_model.simulation.kernel import whole_run as run
from worm_model.simulation.kernel.mode import Constants, Motion, region_of
from worm_model.simulation.kernel.work import cable_power
from worm_model.simulation.rows import gait_rows, parameter_rows
from worm_msgs.robot_parameters import STANDARD_GRAVITY


def _records(times: Array, events: int = 0) -> march.Records:
    """Return records for samples at times (n,) in s and for a number of events."""
    samples = np.empty((times.size, march.SAMPLE_COLUMNS))
    samples[:, march.TIME] = times
    return march.Records(
        np.zeros(march.TOTALS_SIZE), samples, np.empty((events, march.EVENT_COLUMNS))
    )


class SimulationError(RuntimeError):
    """The simulation needed too many steps, as it does if a fin passes a border to and fro without end (chatters)."""


class LoadError(InputError):
    """The fins do not hold the load at the start of a gait, so the robot slides and the gait has no result."""


def _check(failure: float, subject: object, parameters: Parameters) -> None:
    """Raise the error that belongs to a failure of the kernel; 0 is no failure.

    ``subject`` begins the message of a SimulationError: a gait, or a text. The failure SLIDES needs a gait.
    """
    if failure == run.SLIDES and isinstance(subject, Gait):
        load = parameters.rear_load + parameters.front_load
        side = 1 if load > 0.0 else -1
        held = largest_static_load(parameters, side, subject)
        raise LoadError(
            f"rear_load + front_load: {load:.4g} N; the fins hold up to {held:.4g} N at rest, so the robot slides. "
            "Reduce the load"
        )
    if failure:
        raise SimulationError(
            f"{subject}: more than {march.MOST_STEPS} steps in one part of a cycle; a fin probably passes "
            "the border of a groove to and fro without end"
        )


@dataclass(frozen=True)
class GaitResult:
    """Results of a gait over its averaged cycles.

    Attributes:
        gait: the gait.
        speed: mean speed along the gait's direction, m/s.
        power: mean source power, W.
        cost_of_transport: cost of transport, 1; infinite for a gait that does not advance.
        grooves_per_cycle: mean advance per cycle, pitches.
        min_grooves: smallest advance of an averaged cycle, pitches.
        groove_phase: groove phase, m.
        switches: number of switches in all cycles from the start.
    """

    gait: Gait
    speed: float
    power: float
    cost_of_transport: float
    grooves_per_cycle: float
    min_grooves: float
    groove_phase: float
    switches: int


def cost_of_transport(speed: ArrayLike, power: ArrayLike, mass: ArrayLike) -> Array:
    """Return P̄ / (m·g·v̄), elementwise; infinite where the speed is not positive."""
    speed_array, power_array = np.asarray(speed, dtype=float), np.asarray(power, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        cost = power_array / (np.asarray(mass) * STANDARD_GRAVITY * speed_array)
    return np.where(speed_array > 0.0, cost, math.inf)


def check_cycles(cycles: int, averaged: int) -> None:
    """Raise ValueError unless 1 ≤ averaged ≤ cycles."""
    if not 1 <= averaged <= cycles:
        raise ValueError(f"{averaged} of {cycles} cycles cannot be averaged")


def evaluate_gait(
    gait: Gait, parameters: Parameters = PAPER, cycles: int = CYCLES, averaged: int = AVERAGED
) -> GaitResult:
    """Return speed, power and grooves of a gait over the last ``averaged`` of a number of ``cycles`` from the start.

    Raises:
        GaitError: Stroke plus pretension is not below the body length.
        LoadError: The fins do not hold the load.
        ValueError: The number of cycles is impossible.
        SimulationError: A fin chatters.
    """
    check_body(gait.reach, parameters.initial_length)
    check_cycles(cycles, averaged)
    result = np.empty(run.RESULT_COLUMNS)
    run.evaluate(gait_rows(gait)[0], parameter_rows(parameters)[0], cycles, averaged, result)
    _check(result[run.RUN_FAILURE], gait, parameters)
    advance, power = float(result[run.MEAN_ADVANCE]), float(result[run.MEAN_POWER])
    speed = advance * gait.frequency
    return GaitResult(
        gait=gait,
        speed=speed,
        power=power,
        cost_of_transport=float(cost_of_transport(speed, power, parameters.mass)),
        grooves_per_cycle=advance / parameters.pitch,
        min_grooves=float(result[run.LEAST_ADVANCE]) / parameters.pitch,
        groove_phase=groove_phase(parameters),
        switches=int(result[run.RUN_SWITCHES]),
    )


@dataclass(frozen=True)
class Event:
    """Event: a fin leaves its region at ``time`` s.

    ``fin`` is 1 (rear) or 2 (front). ``direction`` is +1 or −1, the direction along x in which the fin's deflection
    passed the border of the region. ``switched`` is True if the anchor of the fin moved by a pitch, and False if the
    fin touched or left the wall.
    """

    time: float
    fin: int
    direction: int
    switched: bool


@dataclass(frozen=True)
class Motions:
    """Dense output: the motion at the times ``time`` (n,). Every field has the shape (n,) and SI units.

    ``cable_force`` is F_c (eq:Fc); where it is negative, the cable would have to push. ``rear_force`` and
    ``front_force`` are the forces of the fins, F_1 and F_2. The anchors A1 and A2 are given in m and as numbers of
    their grooves. ``energy`` is the idle power times ``time``, plus the energy of the cable work since the first
    computed time. The cable work is included only if the length follows from a gait, not if `Locomotion` follows given
    lengths. At the time of an event, the values are those before the event.
    """

    time: Array
    x1: Array
    x2: Array
    v1: Array
    v2: Array
    length: Array
    length_rate: Array
    cable_force: Array
    rear_force: Array
    front_force: Array
    rear_anchor: Array
    front_anchor: Array
    rear_groove: NDArray[np.int64]
    front_groove: NDArray[np.int64]
    power: Array
    energy: Array


def _motions(samples: Array, parameters: Parameters) -> Motions:
    """Return the kernel's samples as `Motions`."""
    time, force, rate = (samples[:, k] for k in (march.TIME, march.FORCE, march.LENGTH_RATE))
    mechanical = cable_power(force, rate, parameters.one_sided_cable)
    power = parameters.idle_power + parameters.power_factor * mechanical
    work = np.maximum(samples[:, march.WORK], 0.0)  # see `run.evaluate`
    energy = parameters.idle_power * time + parameters.power_factor * work
    rear, front = (samples[:, k].astype(np.int64) for k in (march.REAR_GROOVE, march.FRONT_GROOVE))
    return Motions(
        time=time,
        x1=samples[:, march.X1],
        x2=samples[:, march.X2],
        v1=samples[:, march.V1],
        v2=samples[:, march.V2],
        length=parameters.initial_length + samples[:, march.LENGTH_CHANGE],
        length_rate=rate,
        cable_force=force,
        rear_force=samples[:, march.REAR_FORCE],
        front_force=samples[:, march.FRONT_FORCE],
        rear_anchor=np.multiply(rear, parameters.pitch, dtype=np.float64),
        front_anchor=np.multiply(front, parameters.pitch, dtype=np.float64),
        rear_groove=rear,
        front_groove=front,
        power=power,
        energy=energy,
    )


@dataclass(frozen=True)
class Trajectory:
    """Motion and power of the robot under a gait, from the start over a number of cycles.

    It stores no samples; `at` computes them exactly for the requested times. `at` and `events` raise `LoadError` if the
    fins do not hold the load, and `SimulationError` if a fin chatters.
    """

    gait: Gait
    parameters: Parameters
    cycles: int

    @property
    def duration(self) -> float:
        """Duration of the run, s."""
        return self.cycles / self.gait.frequency

    def at(self, times: ArrayLike) -> Motions:
        """Return dense output at ``times`` (n,) in s."""
        records = self._run(_records(_ascending(times, 0.0, self.duration)))
        return _motions(records.samples, self.parameters)

    def events(self) -> list[Event]:
        """Return all events in order."""
        count = self._run(_records(np.empty(0))).totals[march.EVENTS]
        return _events(self._run(_records(np.empty(0), int(count))).events)

    def _run(self, records: march.Records) -> march.Records:
        gait, parameters = gait_rows(self.gait)[0], parameter_rows(self.parameters)[0]
        run.run_gait(gait, parameters, self.cycles, records)
        _check(records.totals[march.FAILURE], self.gait, self.parameters)
        return records


def _ascending(times: ArrayLike, first: float, last: float) -> Array:
    time = np.atleast_1d(np.asarray(times, dtype=float))
    rounding = 1e-9 * (1.0 + abs(last if math.isfinite(last) else first))
    inside = time.size == 0 or (time[0] >= first - rounding and time[-1] <= last + rounding)
    if time.ndim != 1 or not inside or np.any(np.diff(time) < 0.0):
        raise ValueError(f"times must ascend within {first:g} to {last:g} s")
    return np.clip(time, first, last)


def _events(rows: Array) -> list[Event]:
    fins = {guard.REAR_HIGH: (1, 1), guard.REAR_LOW: (1, -1)}
    fins |= {guard.FRONT_HIGH: (2, 1), guard.FRONT_LOW: (2, -1)}
    return [Event(float(time), *fins[int(stop)], bool(switched)) for time, stop, switched in rows]


def _motion_of(state: LocomotionState) -> Motion:
    grooves, regions = (
        (state.rear_groove, state.front_groove),
        (state.rear_region, state.front_region),
    )
    return Motion(state.y, state.y_rate, *grooves, *regions)


def simulate(gait: Gait, parameters: Parameters = PAPER, cycles: int = CYCLES) -> Trajectory:
    """Return the trajectory of a gait from rest; for the initial state see `kernel.whole_run.start_of`.

    Raises:
        GaitError: Stroke plus pretension is not below the body length.
        ValueError: The number of cycles is impossible.
    """
    check_body(gait.reach, parameters.initial_length)
    check_cycles(cycles, cycles)
    return Trajectory(gait, parameters, cycles)


@dataclass(frozen=True)
class LocomotionState:
    """State of a robot whose length is an input.

    ``time`` in s; ``length_change`` ΔL in m; ``y`` = x1 + μ·ΔL in m, and its rate ``y_rate`` in m/s; grooves and
    regions of both fins; number of ``switches`` so far. For y and the regions see `kernel.mode`.
    """

    time: float
    length_change: float
    y: float
    y_rate: float
    rear_groove: int
    front_groove: int
    rear_region: int
    front_region: int
    switches: int = 0


@dataclass(frozen=True)
class Locomotion:
    """Locomotion model (eq:continuous_model to eq:A2_switch) of a robot with the fins in one direction.

    ``direction`` is FORWARD or REVERSE. ``margin`` in m is added to the switching threshold.
    """

    parameters: Parameters = PAPER
    direction: int = FORWARD
    margin: float = 0.0

    def start(
        self,
        time: float = 0.0,
        length_change: float = 0.0,
        x1: float = 0.0,
        front: int | None = None,
    ) -> LocomotionState:
        """Return a state at rest, with the rear anchor at 0.

        Args:
            time: time of the state, s.
            length_change: ΔL, m.
            x1: position of the rear module, m.
            front: number of the front anchor's groove; by default the groove nearest to L0.
        """
        c = self._constants()
        groove = front_groove(self.parameters) if front is None else front
        x2 = x1 + self.parameters.initial_length + length_change
        return LocomotionState(
            time=time,
            length_change=length_change,
            y=x1 + c.body.mu * length_change,
            y_rate=0.0,
            rear_groove=0,
            front_groove=groove,
            rear_region=region_of(x1, c.body.half_clearance),
            front_region=region_of(x2 - groove * c.body.pitch, c.body.half_clearance),
        )

    def at_rest(self, time: float = 0.0, length_change: float = 0.0) -> LocomotionState:
        """Return the state at rest at ``time`` (s), after ΔL has moved from 0 to ``length_change`` (m).

        The robot begins in the state of `start`, with ΔL = 0, and moves until its fins are in equilibrium: with each
        other (beyond δ_c/2 a groove phase deflects the front fin), with a load, and with the change of the length by a
        pretension. Raises `SimulationError` if a fin chatters.
        """
        return self.settled(self.start(time - 2.0 * run.SETTLING_TIME), length_change)

    def settled(self, state: LocomotionState, length_change: float) -> LocomotionState:
        """Return the state 2·`run.SETTLING_TIME` later: ΔL has moved to ``length_change`` (m), and the robot rests."""
        times = [state.time + run.SETTLING_TIME, state.time + 2.0 * run.SETTLING_TIME]
        return self.follow(state, times, [length_change, length_change])[0]

    def x1(self, state: LocomotionState) -> float:
        """Return the position of the rear module in m."""
        return state.y - self._constants().body.mu * state.length_change

    def x2(self, state: LocomotionState) -> float:
        """Return the position of the front module in m."""
        return self.x1(state) + self.parameters.initial_length + state.length_change

    def advance(self, state: LocomotionState, time: float, length_change: float) -> LocomotionState:
        """Return the state at a later ``time`` in s. ΔL moves in a straight line to ``length_change`` in m."""
        return self.follow(state, [time], [length_change])[0]

    def follow(
        self, state: LocomotionState, times: ArrayLike, length_changes: ArrayLike
    ) -> tuple[LocomotionState, Motions]:
        """Return (state at the end, dense output at every sample) under samples of ΔL joined by straight lines.

        ``times`` (n,) in s ascend from the time of the state on; ``length_changes`` (n,) are in m. Without samples, the
        state stays as it is, and the output is empty. The power of the output uses the slopes of the lines; for noisy
        samples see `worm_model.simulation.smoothing`. The energy does not include the cable work (see `Motions`).
        """
        time = np.atleast_1d(np.asarray(times, dtype=float))
        if not time.size and not np.size(length_changes):
            return state, _motions(_records(time).samples, self.parameters)
        values = np.concatenate([[state.length_change], np.atleast_1d(length_changes)])
        breaks = np.concatenate([[state.time], time])
        step = np.diff(breaks)
        slope = np.divide(np.diff(values), step, out=np.zeros_like(step), where=step > 0.0)
        coefficients = np.zeros((4, time.size))
        coefficients[0], coefficients[1] = values[:-1], slope
        return self.follow_polynomial(state, breaks, coefficients, time)

    def follow_polynomial(
        self, state: LocomotionState, breaks: ArrayLike, coefficients: ArrayLike, times: ArrayLike
    ) -> tuple[LocomotionState, Motions]:
        """Return (state at the last break, dense output at ``times``) under a piecewise cubic ΔL.

        Args:
            state: state at the first break.
            breaks: borders of at least one piece (n + 1,), s, ascending.
            coefficients: coefficients of each piece (4, n), constant term first (m, m/s, …), for the time since the
                break at which the piece begins.
            times: times of the output (m,), s, ascending within the breaks.
        """
        knots = np.ascontiguousarray(breaks, dtype=float)
        forms = np.ascontiguousarray(coefficients, dtype=float)
        if knots.size < 2:
            raise ValueError(f"breaks: {knots.size} value(s), but a piece has two borders")
        if not (np.all(np.isfinite(knots)) and np.all(np.isfinite(forms))):
            raise ValueError("times and lengths must be finite: exclude missing samples")
        records = _records(_ascending(times, knots[0], knots[-1]))
        after = run.run_sampled(knots, forms, _motion_of(state), self._constants(), None, records)
        _check(records.totals[march.FAILURE], f"after {state.time:g} s", self.parameters)
        last = knots[-1] - knots[-2]
        final = LocomotionState(
            float(knots[-1]),
            float(np.polynomial.polynomial.polyval(last, forms[:, -1])),
            *(after.y, after.rate),
            *(after.rear_groove, after.front_groove, after.rear_region, after.front_region),
            state.switches + int(records.totals[march.SWITCHES]),
        )
        return final, _motions(records.samples, self.parameters)

    def _constants(self) -> Constants:
        return _constants_of(self.parameters, self.direction, self.margin)


@lru_cache(maxsize=16)
def _constants_of(parameters: Parameters, direction: int, margin: float) -> Constants:
    """Return the kernel's constants. They are cached, because most methods of `Locomotion` need them."""
    return run.constants_of(parameter_rows(parameters)[0], float(direction), margin)
