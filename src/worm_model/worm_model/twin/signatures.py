# SPDX-License-Identifier: Apache-2.0
"""Signatures of the causes: the changes of the residuals that each cause makes.

A signature is the difference between two simulations, with and without the cause. It covers a cycle of the steady gait,
in `BINS` bins of `CHANNELS` channels (rear position in m, measured length in m, power in W). The signature of a lasting
cause is scaled to the cause's usual size. A missed groove is a switch of one fin that does not happen: the threshold of
this fin is out of reach until the other fin switches. A gained groove is one switch too many: the threshold of the fin
is lower until the other fin switches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import assert_never

import numpy as np

from worm_model.arrays import Array
from worm_model.gait import Gait, GaitError
from worm_model.parameters import ParameterError, Parameters
from worm_model.simulation.actuation import length_change_of_command
from worm_model.simulation.simulator import LoadError, Locomotion, SimulationError, simulate
from worm_model.twin.cause_table import LASTING, Cause, Effect
from worm_model.twin.core.memory import CHANNELS, LENGTH, PHASES, POSITION, POWER

BINS = 25  # of a cycle
SETTLED = 5  # cycles after which a gait repeats itself
CYCLES = SETTLED + 3
NEVER_M = 1.0  # margin with which a fin never switches
EARLIER_M = (0.002, 0.005, 0.008, 0.012)  # tested reductions of the threshold for gained grooves
GROOVES = {1: 2, 2: 3}  # row of a fin's grooves in the result of `_follow`
SMALL = 0.2  # fraction of the usual size up to which the effect is assumed proportional to the size
L0_STEP_M, L0_REACH = 0.0005, 0.5  # step (m) and largest value (pitches) of the tested errors of L0

#: standard deviations of a healthy robot's parameters around the twin's, relative to the twin's
HEALTHY_SPREAD = {
    "gain": 0.01,
    "slack": 0.03,
    "time_constant": 0.08,  # it contains the delay of the servos and of the stamps
    "viscous_friction": 0.05,
    "switching_threshold": 0.02,
    "clearance": 0.02,
    "engaged_stiffness": 0.03,
    "disengaged_stiffness": 0.03,
    "bellows_stiffness": 0.02,
    "bellows_damping": 0.02,
    "idle_power": 0.03,
    "power_factor": 0.02,
}
HEALTHY_SPREAD_L0_M = 0.0004


@dataclass(frozen=True)
class AnotherLength:
    """Signature of a wrong L0.

    Attributes:
        error: amount that is added to the twin's L0, m.
        gained: additional grooves per cycle.
        change: change of the residuals, shape (CHANNELS, BINS).
    """

    error: float
    gained: int
    change: Array


@dataclass(frozen=True)
class Signatures:
    """Signatures of a gait and a robot; every change has the shape (CHANNELS, BINS).

    Attributes:
        grooves: grooves per cycle.
        power: predicted power, W, shape (BINS,).
        lasting: changes by lasting causes at their usual size, by name. Shape (1 + k, CHANNELS, BINS): from a small
            change, and from k large changes that keep the grooves per cycle.
        missed: changes by a missed groove, by fin. Shape (2, CHANNELS, BINS): the previous cycle, and the cycle in
            which x1 falls behind.
        gained: changes by a gained groove, by fin and lower threshold. Shape (2, CHANNELS, BINS): the previous cycle,
            and the cycle in which x1 gets ahead.
        healthy: changes by usual differences between healthy robots, by parameter.
        lengths: signatures of other initial lengths.
    """

    grooves: int
    power: Array
    lasting: Mapping[str, Array]
    missed: Mapping[str, Array]
    gained: Mapping[str, Array]
    healthy: Mapping[str, Array]
    lengths: tuple[AnotherLength, ...]


def binned(values: Array) -> Array:
    """Return the means over bins (…, BINS) of values at phases (…, PHASES)."""
    shape = (*values.shape[:-1], BINS, PHASES // BINS)
    means: Array = values.reshape(shape).mean(axis=-1)
    return means


@lru_cache(maxsize=32)
def signatures(gait: Gait, parameters: Parameters, *, driven: bool) -> Signatures:
    """Return the signatures of a gait as played, without its margin.

    The first call for a gait takes a tenth of a second, later calls use a cache.

    Args:
        gait: the gait.
        parameters: parameters with the L0 of the run.
        driven: True if a measured length drives the twin. A changed answer to the command then affects only the
            residual of the length. Otherwise it affects all residuals except that of the length.
    """
    gait = replace(gait, margin=0.0)
    model = _Model(gait, parameters, driven)
    return Signatures(
        grooves=model.grooves,
        power=model.seen[POWER],
        lasting={name: _lasting(model, cause) for name, cause in LASTING.items()},
        missed=_switches(model, {"": NEVER_M}, -1),
        gained=_switches(model, {f" {1e3 * early:g} mm early": -early for early in EARLIER_M}, 1),
        healthy=_healthy(model),
        lengths=tuple(_lengths(model)),
    )


class _Model:
    """Steady cycle of a robot with the twin's parameters, and the effects of changed parameters or commands."""

    def __init__(self, gait: Gait, parameters: Parameters, driven: bool) -> None:  # noqa: FBT001
        self.gait, self.parameters, self.driven = gait, parameters, driven
        phases = (np.arange(PHASES) + 0.5) / PHASES
        self.times = ((np.arange(CYCLES)[:, None] + phases) * gait.period).ravel()
        self.commands = np.array([gait.command(time) for time in self.times.tolist()])
        self.length = self._length(parameters, self.commands)
        try:
            self.seen, self.grooves = self._cycle(parameters, self.commands, 0.0)
        except (LoadError, SimulationError):  # without a steady gait there are no signatures
            self.seen, self.grooves = np.zeros((CHANNELS, BINS)), 0

    def _length(self, parameters: Parameters, commands: Array) -> Array:
        return length_change_of_command(
            np.append(0.0, self.times), np.append(0.0, commands), parameters, at=self.times
        )

    def _cycle(self, parameters: Parameters, commands: Array, error: float) -> tuple[Array, int]:
        """Return the quantities of a steady cycle (CHANNELS, BINS), and the grooves gained in this cycle.

        ``error`` (m) is added to the measured length.
        """
        length = self._length(parameters, commands)
        moves = self.length if self.driven else length
        robot = Locomotion(parameters, self.gait.direction)
        motions = robot.follow(robot.start(), self.times, moves)[1]
        place = SETTLED * PHASES
        x1 = motions.x1 - motions.rear_groove[place - 1] * parameters.pitch
        channels = np.zeros((CHANNELS, BINS))
        for channel, values in ((POSITION, x1), (LENGTH, length + error), (POWER, motions.power)):
            channels[channel] = binned(values[place : place + PHASES])
        if not self.driven:
            channels[LENGTH] = 0.0
        gained = motions.rear_groove[place + PHASES - 1] - motions.rear_groove[place - 1]
        return channels, self.gait.direction * int(gained)

    def change(self, commands: Array | None = None, **values: float) -> tuple[Array, int]:
        """Return the effect (CHANNELS, BINS) of other commands or parameters, and the additional grooves per cycle.

        The effect is 0 if the model does not permit the ``values`` of the parameters.
        """
        try:
            shown, grooves = self._cycle(
                self.parameters.replace(**values),
                self.commands if commands is None else commands,
                0.0,
            )
        except (LoadError, ParameterError, SimulationError):
            return np.zeros((CHANNELS, BINS)), 0
        return shown - self.seen, grooves - self.grooves

    def extrapolated(self, change: Callable[[float], tuple[Array, int]]) -> Array:
        """Return the effect of a change at its usual size, extrapolated from a small change.

        ``change`` returns the effect and the additional grooves of a fraction of the usual change. The first of several
        fractions that has an effect and keeps the number of grooves is used. If there is none, the effect is 0.
        """
        for step in (SMALL, -SMALL, 0.2 * SMALL, -0.2 * SMALL):
            effect, grooves = change(step)
            if grooves == 0 and effect.any():
                return effect / step
        return np.zeros((CHANNELS, BINS))

    def changed(self, key: str, amount: float) -> Callable[[float], tuple[Array, int]]:
        """Return `change` as a function of a share of an ``amount`` that is added to a parameter."""
        return lambda share: self.change(**{key: getattr(self.parameters, key) + share * amount})


def _lasting(model: _Model, cause: Cause) -> Array:
    """Return the effects of a lasting cause, scaled to its usual size: from a small change, then from large ones."""
    change = _change_of(model, cause)
    effects = [model.extrapolated(change)]
    for size in cause.large:
        effect, grooves = change(size)
        if grooves == 0:
            effects.append(effect / size)
    return np.array(effects)


def _change_of(model: _Model, cause: Cause) -> Callable[[float], tuple[Array, int]]:
    """Return a function of a size (a multiple of the usual one), which returns effect and additional grooves."""
    p, on_power = model.parameters, np.zeros((CHANNELS, BINS))
    match cause.effect:
        case Effect.RELATIVE:
            return model.changed(cause.name, cause.size * getattr(p, cause.name))
        case Effect.ABSOLUTE:
            return model.changed(cause.name, cause.size)
        case Effect.BOTH_LOADS:
            half = 0.5 * cause.size
            return lambda size: model.change(
                rear_load=p.rear_load + size * half, front_load=p.front_load + size * half
            )
        case Effect.LOOSE_CABLE:
            return lambda size: model.change(np.minimum(model.commands + size * cause.size, 0.0))
        case Effect.POWER_SCALE:
            on_power[POWER] = cause.size * model.seen[POWER]
        case Effect.POWER_OFFSET:
            on_power[POWER] = cause.size
        case _:
            assert_never(cause.effect)
    return lambda size: (size * on_power, 0)


def _healthy(model: _Model) -> dict[str, Array]:
    """Return the effects of usual differences between healthy robots, by parameter."""
    relative = HEALTHY_SPREAD | {
        "initial_length": HEALTHY_SPREAD_L0_M / model.parameters.initial_length
    }
    return {
        key: model.extrapolated(model.changed(key, size * getattr(model.parameters, key)))
        for key, size in relative.items()
    }


def _lengths(model: _Model) -> list[AnotherLength]:
    """Return the signatures of other initial lengths."""
    p = model.parameters
    count = int(L0_REACH * p.pitch / L0_STEP_M)
    lengths = []
    for k in (k for k in range(-count, count + 1) if k):
        error = k * L0_STEP_M
        change, gained = model.change(initial_length=p.initial_length + error)
        lengths.append(AnotherLength(error, gained, change))
    return lengths


# --- a switch that is missing, or happens once too often ----------------------------------------------------


def _switches(model: _Model, margins: Mapping[str, float], grooves: int) -> dict[str, Array]:
    """Return the signatures of another threshold at a fin's last switch of a cycle.

    ``margins`` contains the changes of the threshold (m). The keys of the result are the fin's name and the key of the
    margin. Only changes that gain ``grooves`` grooves (1 or −1) are included.
    """
    changes = {
        f"{name}{how}": _switched(model, fin, margin, grooves)
        for name, fin in (("rear", 1), ("front", 2))
        for how, margin in margins.items()
    }
    return {name: change for name, change in changes.items() if change is not None}


def _switched(model: _Model, fin: int, margin: float, grooves: int) -> Array | None:
    gait, parameters = model.gait, model.parameters
    window = _window(gait, parameters, fin)
    if window is None or model.grooves < 1:
        return None
    begins, ends = window
    try:
        usual = _follow(model, (0.0, 0.0), 0.0)
        if margin < 0.0:  # the lower threshold causes one switch after the last one, and no other
            begins += 1e-3
            early = _follow(model, (begins, ends), margin)
            differs = np.flatnonzero(early[GROOVES[fin]] != usual[GROOVES[fin]])
            ends = float(model.times[differs[0]]) if differs.size else ends
        other = _follow(model, (begins, ends), margin)
    except (LoadError, SimulationError):
        return None
    pitch = parameters.pitch
    x1, power = other[:2] - usual[:2]
    ends_at = gait.direction * np.round(x1.reshape(CYCLES, PHASES)[:, -1] / pitch).astype(int)
    behind = np.flatnonzero(ends_at == grooves)
    if not behind.size or ends_at[-1] != grooves:
        return None
    place = (int(behind[0]) - 1) * PHASES
    change = np.zeros((2, CHANNELS, BINS))
    for channel, values in ((POSITION, x1), (POWER, power)):
        change[:, channel] = binned(values[place : place + 2 * PHASES].reshape(2, PHASES))
    return change


def _window(gait: Gait, parameters: Parameters, fin: int) -> tuple[float, float] | None:
    """Return (time just before a fin's last switch in a steady cycle, time just before the other fin's next switch), s.

    The result is None if there are no such switches. It is also None if the gait has no run from rest: the fins do not
    hold the load, a fin chatters, or the twin's body is too short for the gait.
    """
    try:
        events = simulate(gait, parameters, CYCLES).events()
    except (GaitError, LoadError, SimulationError):
        return None
    events = [e for e in events if e.switched and e.direction == gait.direction]
    mine = [e.time for e in events if e.fin == fin]
    others = [e.time for e in events if e.fin != fin]
    first = next((time for time in mine if time > SETTLED * gait.period), None)
    if first is None:
        return None
    after = next((time for time in others if time > first), None)
    if after is None:
        return None
    last = max(time for time in mine if time < after)
    return last - 1e-6, after - 1e-6


def _follow(model: _Model, window: tuple[float, float], margin: float) -> Array:
    """Return x1 (m), power (W), rear and front groove at the model's times, shape (4, n).

    In a time window (s) the margin (m) is another.
    """
    times, length = model.times, model.length
    state = Locomotion(model.parameters, model.gait.direction).start()
    parts = []
    for until, used in ((window[0], 0.0), (window[1], margin), (times[-1], 0.0)):
        if until <= state.time:
            continue
        inside = times[(times > state.time) & (times <= until)]
        asked = np.append(inside, until) if inside.size == 0 or inside[-1] < until else inside
        robot = Locomotion(model.parameters, model.gait.direction, used)
        state, m = robot.follow(state, asked, np.interp(asked, times, length))
        row = np.array([m.x1, m.power, m.rear_groove, m.front_groove])
        parts.append(row[:, : inside.size])
    return np.concatenate(parts, axis=1)
