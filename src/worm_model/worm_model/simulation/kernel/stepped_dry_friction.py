# SPDX-License-Identifier: Apache-2.0
"""Locomotion model with dry friction, integrated in steps along a sampled length.

It approximates `worm_model.simulation.kernel.march` and is the only part of the model with a step size. Identification
fits with it, because it allows grooves that differ and takes half the time along a sampled length. A test limits its
difference from the exact model. The fitted parameters are then checked, and used, in the exact model.

The state is y = x1 + μ·ΔL as everywhere. The friction of a module is (η + F/(|v| + v_s))·v. Dry friction fades below
the speed v_s, so that it is a function of the speed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from worm_model.simulation.kernel.compiled import inlined, unlocked
from worm_model.simulation.kernel.mode import nearest_groove_of

FADING_SPEED = 1e-3  # m/s
SHORTEST_STEP = 1e-9  # s, after a switch at a step's end
MOST_SWITCHES = 8  # in a step; with more, the anchors switch to and fro

# Columns of a row of samples: rear module, its velocity, and the cable force without the body's part
X1, V1, HOLDING_FORCE = range(3)
SAMPLE_COLUMNS = 3
# Columns of a row of grooves
THRESHOLD, STIFFNESS = range(2)
GROOVE_COLUMNS = 2
FIRST_GROOVE = 2  # row of the groove in which a module starts


class Worm(NamedTuple):
    """Parameters in SI units; ``direction`` is that of the fins, ±1, ``rear_dry`` and ``front_dry`` are in N.

    ``onset`` selects the velocities after ΔL has begun with a step of its rate. 0: the centre of mass stays at rest,
    as the modules share the rate by their masses. 1: the rear module stays at rest, as in the paper's initial values.
    ``load`` of both modules, N, is positive towards −x. ``start`` is the deflection of the rear fin at rest, m.
    """

    direction: float
    rear_mass: float
    front_mass: float
    initial_length: float
    friction: float
    pitch: float
    engaged_stiffness: float
    disengaged_stiffness: float
    threshold: float
    clearance: float
    rear_dry: float
    front_dry: float
    onset: float = 0.0
    load: float = 0.0
    start: float = 0.0


@inlined
def _spring(stretch: float, factor: float, worm: Worm) -> tuple[float, float]:
    """Return (stiffness, rest) of a fin, whose force is stiffness·(stretch − rest) (eq:fin_force_piecewise)."""
    half = 0.5 * worm.clearance
    if abs(stretch) <= half:
        return 0.0, 0.0
    slides = stretch * worm.direction > 0.0  # forward fins are stiff when pushed backward
    stiffness = worm.disengaged_stiffness if slides else worm.engaged_stiffness
    return factor * stiffness, math.copysign(half, stretch)


@inlined
def _drag(velocity: float, dry: float, worm: Worm) -> float:
    return worm.friction + dry / (abs(velocity) + FADING_SPEED)


class _Piece(NamedTuple):
    """Constants of a step: ΔL at its start and its slope, the anchors and the factors of their stiffness."""

    start: float
    slope: float
    rear_anchor: float
    front_anchor: float
    rear_factor: float
    front_factor: float


@inlined
def _implicit_step(
    y: float,
    rate: float,
    h: float,
    piece: _Piece,
    y_seen: float,
    rate_seen: float,
    at: float,
    worm: Worm,
) -> tuple[float, float, float, float]:
    """Return (mean ẏ, weight of the end, drag and fin force of the rear module) of a step of ``h`` seconds.

    The fins' regions and the drags are those of the state ``y_seen``, ``rate_seen``, ``at`` seconds into the step.
    The rest is solved implicitly, by the trapezoidal rule unless the drag is so high that it would ring.
    """
    mass = worm.rear_mass + worm.front_mass
    mu = worm.front_mass / mass
    v1 = rate_seen - mu * piece.slope
    rear_drag = _drag(v1, worm.rear_dry, worm)
    front_drag = _drag(v1 + piece.slope, worm.front_dry, worm)
    drag = rear_drag + front_drag
    change = piece.start + at * piece.slope
    rear_k, rear_rest = _spring(y_seen - mu * change - piece.rear_anchor, piece.rear_factor, worm)
    front_offset = worm.initial_length - piece.front_anchor
    front_seen = y_seen + (1.0 - mu) * change + front_offset
    front_k, front_rest = _spring(front_seen, piece.front_factor, worm)
    weight = max(0.5, 1.0 - mass / (drag * h))
    along = piece.start + weight * h * piece.slope
    rear_rest += mu * along + piece.rear_anchor
    force = (rear_drag * mu - front_drag * (1.0 - mu)) * piece.slope + rear_k * rear_rest
    force += front_k * (front_rest - front_offset - (1.0 - mu) * along) - worm.load
    # mass·(ẏ' − ẏ)/h = force − drag·ẏw − k·yw at the weighted moment, y' = y + h·ẏw, yw = y + weight·h·ẏw
    inertia, k = mass / (weight * h), rear_k + front_k
    mean_rate = (force + inertia * rate - k * y) / (inertia + drag + k * weight * h)
    fin_force = rear_k * (y + weight * h * mean_rate - rear_rest)
    return mean_rate, weight, rear_drag, fin_force


@inlined
def _step(y: float, rate: float, h: float, piece: _Piece, worm: Worm) -> tuple[float, float, float]:
    """Return (y, ẏ, force of friction and fin on the rear module) after ``h`` seconds, of second order in ``h``."""
    mean_rate, weight, drag, force = _implicit_step(y, rate, h, piece, y, rate, 0.0, worm)
    middle, middle_rate = y + 0.5 * h * mean_rate, rate + 0.5 * (mean_rate - rate) / weight
    mean_rate, weight, drag, force = _implicit_step(
        y, rate, h, piece, middle, middle_rate, 0.5 * h, worm
    )
    mu = worm.front_mass / (worm.rear_mass + worm.front_mass)
    holding = drag * (mean_rate - mu * piece.slope) + force
    return y + h * mean_rate, rate + (mean_rate - rate) / weight, holding


@inlined
def _first_switch(
    rear_before: float,
    rear_after: float,
    rear_threshold: float,
    front_before: float,
    front_after: float,
    front_threshold: float,
) -> tuple[float, int, int]:
    """Return (fraction of the step until the first threshold is passed, steps of the rear and front anchors)."""
    fraction, rear, front = 1.0, 0, 0
    if abs(rear_after) > rear_threshold:
        border = math.copysign(rear_threshold, rear_after)
        fraction = (border - rear_before) / (rear_after - rear_before)
        rear = 1 if rear_after > 0.0 else -1
    if abs(front_after) > front_threshold:
        border = math.copysign(front_threshold, front_after)
        own = (border - front_before) / (front_after - front_before)
        if rear == 0 or own < fraction:
            fraction, rear, front = own, 0, 1 if front_after > 0.0 else -1
    return min(max(fraction, 0.0), 1.0), rear, front


@inlined
def _row(groove: int, grooves: np.ndarray) -> int:
    """Return the row of a groove, counted from the groove of the module's start in row FIRST_GROOVE."""
    return min(max(groove + FIRST_GROOVE, 0), grooves.shape[0] - 1)


class _State(NamedTuple):
    """State between steps: y, its rate, and the grooves that each anchor has moved."""

    y: float
    rate: float
    rear: int
    front: int


@inlined
def _advance(
    state: _State,
    step: float,
    start: float,
    end: float,
    lattice: float,
    worm: Worm,
    rear_grooves: np.ndarray,
    front_grooves: np.ndarray,
) -> tuple[_State, float, int]:
    """Return (state after a step, force on the rear module, switches or −1); ΔL moves straight to ``end``."""
    mu = worm.front_mass / (worm.rear_mass + worm.front_mass)
    y, rate, rear, front = state.y, state.rate, state.rear, state.front
    slope, left = (end - start) / step, step
    for switches in range(MOST_SWITCHES + 1):
        rear_row, front_row = _row(rear, rear_grooves), _row(front, front_grooves)
        piece = _Piece(
            start,
            slope,
            rear * worm.pitch,
            lattice + front * worm.pitch,
            1.0 + rear_grooves[rear_row, STIFFNESS],
            1.0 + front_grooves[front_row, STIFFNESS],
        )
        new_y, new_rate, holding = _step(y, rate, left, piece, worm)
        fraction, rear_move, front_move = _first_switch(
            y - mu * start - piece.rear_anchor,
            new_y - mu * end - piece.rear_anchor,
            worm.threshold + rear_grooves[rear_row, THRESHOLD],
            y + (1.0 - mu) * start + worm.initial_length - piece.front_anchor,
            new_y + (1.0 - mu) * end + worm.initial_length - piece.front_anchor,
            worm.threshold + front_grooves[front_row, THRESHOLD],
        )
        if rear_move == 0 and front_move == 0:
            return _State(new_y, new_rate, rear, front), holding, switches
        spent = fraction * left
        if spent > 0.0:
            y, rate, holding = _step(y, rate, spent, piece, worm)
        start += spent * slope
        left = max(left - spent, SHORTEST_STEP)
        rear += rear_move
        front += front_move
    return _State(y, rate, rear, front), 0.0, -1


@inlined
def _add_inertia(step: float, mass: float, samples: np.ndarray) -> None:
    """Add M1·v̇1, from sample to sample."""
    for at in range(1, samples.shape[0]):
        gain = samples[at, V1] - samples[at - 1, V1]
        samples[at, HOLDING_FORCE] += mass * gain / step


@unlocked
def slide(
    step: float,
    length_changes: np.ndarray,
    worm: Worm,
    rear_grooves: np.ndarray,
    front_grooves: np.ndarray,
    samples: np.ndarray,
) -> int:
    """Follow ΔL from rest, the front anchor on the nearest groove, and return the number of switches.

    ``length_changes`` (n,) in m at every ``step`` s, the first at rest, straight lines between them. The grooves
    that a module passes, (m, GROOVE_COLUMNS), each differ from the worm's values by a threshold in m and a relative
    stiffness; it starts in the row FIRST_GROOVE. ``samples`` (n, SAMPLE_COLUMNS) receives x1 from its rest in m, v1 in
    m/s and M1·v̇1 + friction + F_1 in N (eq:Fc) over the step that ends there. The result is −1 if the anchors switch
    to and fro without end.
    """
    mu = worm.front_mass / (worm.rear_mass + worm.front_mass)
    lattice = worm.pitch * nearest_groove_of(worm.initial_length, worm.pitch)
    onset_rate = worm.onset * mu * (length_changes[1] - length_changes[0]) / step
    state, total = _State(worm.start + mu * length_changes[0], onset_rate, 0, 0), 0
    samples[0, X1], samples[0, V1], samples[0, HOLDING_FORCE] = 0.0, 0.0, 0.0
    for at in range(1, length_changes.size):
        start, end = length_changes[at - 1], length_changes[at]
        state, holding, switches = _advance(
            state, step, start, end, lattice, worm, rear_grooves, front_grooves
        )
        if switches < 0:
            return -1
        total += switches
        samples[at, X1] = state.y - mu * end - worm.start
        samples[at, V1] = state.rate - mu * (end - start) / step
        samples[at, HOLDING_FORCE] = holding
    _add_inertia(step, worm.rear_mass, samples)
    return total
