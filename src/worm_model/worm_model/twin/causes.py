# SPDX-License-Identifier: Apache-2.0
"""Bayesian weighting of the causes that can explain the last cycles of a run.

The data are the binned residuals of the remembered cycles. In the null hypothesis the robot is healthy: its parameters
differ a little from the twin's, by the same amounts in every cycle, and its cycles scatter a little. These alternatives
compete with the null hypothesis:

- a lasting change of any size, from some moment on
- a groove that a fin missed or gained, in one or more consecutive cycles
- another initial length since the beginning of the run
- an unexplained deviation in a single cycle; without this alternative, the known cause that fits least badly would win

The weight of a cause decreases if the cause does not explain the residuals of all instruments together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.twin.cause_table import (
    CAMERA_MOVED,
    GAINED,
    INITIAL_LENGTH,
    LASTING,
    MISSED_BY_FIN,
    EventCode,
)
from worm_model.twin.core.memory import CHANNELS, POSITION, POWER
from worm_model.twin.cycle_data import POWER_SHARE, SCATTER, CycleData
from worm_model.twin.inference import NullModel
from worm_model.twin.signatures import BINS, L0_STEP_M, Signatures

#: deviation without a known cause; TwinEvent has no code for it
UNEXPLAINED = EventCode("", "an unexplained deviation in a single cycle", "", "")

CHANGE = 0.004  # probability that a change of one kind begins in a cycle
# Probabilities per cycle that a fin misses a groove, misses one in the next cycle as well, and gains one.
MISS, AGAIN, GAIN = 0.02, 0.3, 0.005
# Probability that L0 is wrong; standard deviation of the error, m.
WRONG_LENGTH, LENGTH_SPREAD_M = 0.01, 0.003
RIGHT = 0.95  # probability that a cycle gains the predicted number of grooves
DEVIATION = 0.001  # probability of an unexplained deviation in a cycle
DEVIATION_SCATTER = (0.01, 0.002, 1.0)  # standard deviations of such a deviation: m, m, W
CAMERA_M = 0.03  # usual step of the positions when the camera is moved
ONSETS = (0.0, 0.25, 0.5, 0.75)  # tested phases of a cycle at which a change begins
BROAD = 4.0  # prior standard deviation of a reported change, relative to its usual size
SHIFT = 1.0  # standard deviation of a channel's offset in a cycle, relative to SCATTER
LARGEST = 300.0  # natural logarithm of the largest weight
THRESHOLDS = 0.5  # scatter of thresholds between cycles, relative to the scatter between robots


@dataclass(frozen=True)
class ReportedCause:
    """Cause already reported, whose effect is included in the model of later cycles.

    Attributes:
        name: name of a lasting cause in the signatures, or "missed" or "gained"; empty for a step that is not
            attributed to a fin.
        cycle: cycle in which the cause begins.
        phase: phase of the cycle at which the cause begins, 0 to 1.
        gained: grooves that the robot gained in addition to the predicted ones; 0 for a cause other than a groove.
    """

    name: str
    cycle: int
    phase: float = 0.0
    gained: int = 0


class Candidate(NamedTuple):
    """Candidate cause, with its weight once it has been computed.

    Attributes:
        code: code of TwinEvent, or `UNEXPLAINED`.
        name: name in the signatures.
        cycle: first cycle of the cause.
        log_prior: natural logarithm of the prior probability of the cause.
        phase: phase of the first cycle at which the cause begins, 0 to 1.
        cycles: number of cycles that the cause lasts, 0 without an end.
        fact: True if the size is not estimated, but known to be 1, as for a groove.
        healthy: True if a healthy robot near an edge gains these grooves.
        variant: index of the signature among those of the name.
        error: amount to be added to the twin's L0, m.
        weight: posterior probability divided by that of a healthy robot.
        size: estimated size, as a multiple of the cause's usual size (`cause_table.Cause.size`).
        deviation: standard deviation of the size.
    """

    code: EventCode
    name: str
    cycle: int
    log_prior: float
    phase: float = 0.0
    cycles: int = 0
    fact: bool = False
    healthy: bool = False
    variant: int = 0
    error: float = 0.0
    weight: float = 0.0
    size: float = 0.0
    deviation: float = 0.0


def weigh_causes(
    cycles: Sequence[CycleData],
    reported: Sequence[ReportedCause],
    signs: Signatures,
    *,
    length_seen: bool,
    steps: Sequence[Candidate] = (),
) -> list[Candidate]:
    """Return all candidates for the remembered cycles with their weights; a healthy robot has the weight 1.

    Args:
        cycles: the remembered cycles, ascending.
        reported: causes already reported.
        signs: signatures of gait and robot.
        length_seen: True if an instrument measured L0, so that no other L0 is a candidate.
        steps: steps of the camera as further candidates.
    """
    data = Data(cycles, reported, signs)
    lasting = list(_lasting(cycles, signs))
    grooves = list(_grooves(cycles, reported, signs))
    tracked = any(cycle.step is not None for cycle in cycles)
    # Without a tracker, another L0 is no candidate, because power alone cannot distinguish it from a missed groove.
    lengths = list(_lengths(cycles, signs)) if tracked and not length_seen else []
    candidates = [*lasting, *steps, *grooves, *(candidate for candidate, _ in lengths)]
    causes = np.array(
        [
            *data.lasting(lasting),
            *map(data.step, steps),
            *map(data.direction, grooves),
            *(direction for _, direction in lengths),
        ]
    )
    known = np.array([candidate.fact for candidate in candidates])
    null = NullModel(data.seen, data.weight, data.nuisances, data.offsets)
    weighed = null.weigh(causes, known)
    logs = np.array([c.log_prior for c in candidates]) + weighed.evidence
    deviating = NullModel(data.seen, data.unexplained(), data.nuisances, data.offsets)
    unexplained = math.log(DEVIATION) + deviating.log_densities() - null.log_densities()
    # The limit takes effect only where a healthy robot (weight 1) is practically impossible.
    logs, unexplained = np.split(_limited(np.append(logs, unexplained)), [len(logs)])
    weights = np.exp(logs)
    least = np.array([LASTING[c.name].least for c in lasting])
    weights[: len(lasting)][weighed.size[: len(lasting)] < least] = 0.0  # a negative parameter
    # The first two cycles of a robot that the parameters do not describe only show how it differs. Power alone cannot
    # distinguish a cause that exists from the start from such a difference.
    since = cycles[0].number + (2 if cycles[0].is_misfit else 0 if tracked else 1)
    weights[
        [c.cycle < since and c.code not in (INITIAL_LENGTH, CAMERA_MOVED) for c in candidates]
    ] = 0.0
    values = (weights.tolist(), weighed.size.tolist(), weighed.deviation.tolist())
    known_causes = [
        c._replace(code=_code(c, size), weight=weight, size=size, deviation=deviation)
        for c, weight, size, deviation in zip(candidates, *values, strict=True)
    ]
    others = [
        Candidate(UNEXPLAINED, "", number, math.log(DEVIATION), cycles=1, weight=weight)
        for number, weight in zip(data.numbers, np.exp(unexplained).tolist(), strict=True)
        if number >= since
    ]
    return known_causes + others


def _limited(logs: Array) -> Array:
    """Return logarithms of weights, shifted by a common amount so that none exceeds `LARGEST`."""
    return logs - max(float(logs.max()) - LARGEST, 0.0)


def _code(candidate: Candidate, size: float) -> EventCode:
    """Return the candidate's code, which for a lasting cause depends on the sign of its size."""
    row = LASTING.get(candidate.name)
    return candidate.code if row is None else row.code(size)


class Data:
    """Residuals of the cycles, with their weights and nuisance directions.

    Attributes:
        signs: signatures of gait and robot.
        numbers: numbers of the cycles.
        seen: residuals, shape (cycles, channels times bins).
        weight: inverse variances of the residuals, 0 without data, in the same shape.
        offsets: standard deviations of the offset that a bin has in all cycles, shape (channels times bins,).
        nuisances: effects with unknown sizes other than the causes, shape (cycles, channels times bins, nuisances).
    """

    def __init__(
        self, cycles: Sequence[CycleData], reported: Sequence[ReportedCause], signs: Signatures
    ) -> None:
        self.signs, self.numbers = signs, [cycle.number for cycle in cycles]
        values = np.array([cycle.values for cycle in cycles])
        variance = np.array([cycle.variance for cycle in cycles])
        for event in reported:
            if not event.name and event.cycle in self.numbers:
                variance[self.numbers.index(event.cycle), POWER] = np.inf
        variance *= _excess(values, variance)[None, :, None]
        # Of a robot that the parameters do not describe, only changes count: its offsets are free, and its cycles
        # differ more.
        error = np.ones(CHANNELS)
        if cycles[0].is_misfit:
            error = np.max([cycle.error for cycle in cycles], axis=0)
        self.offsets = (_offsets(signs) * error[:, None]).ravel()
        variance += (THRESHOLDS * (error - 1.0)[:, None] * _offsets(signs)) ** 2
        self.seen = values.reshape(len(cycles), -1)
        self.weight = 1.0 / variance.reshape(self.seen.shape)
        nuisances = [*self._of_the_run(), *self._of_a_cycle(), *self._reported(reported)]
        self.nuisances = np.moveaxis(np.array(nuisances), 0, -1)

    def direction(self, candidate: Candidate) -> Array:
        """Return the effect of a candidate at its usual size, shape (cycles, channels times bins)."""
        if not candidate.cycles:
            return self.lasting([candidate])[0]
        numbers = range(candidate.cycle, candidate.cycle + candidate.cycles)
        return self._grooves(candidate.name, candidate.code == GAINED, numbers)

    def lasting(self, causes: Sequence[Candidate]) -> Array:
        """Return the effects of lasting causes, shape (causes, cycles, channels times bins)."""
        changes = np.array([self.signs.lasting[cause.name][cause.variant] for cause in causes])
        since = self._bins_before([c.cycle for c in causes], [c.phase for c in causes])
        bins = np.arange(len(self.numbers) * BINS).reshape(-1, 1, BINS)
        whole = changes[:, None] * (bins >= since[:, None, None, None])
        return whole.reshape(len(causes), *self.seen.shape)

    def step(self, candidate: Candidate) -> Array:
        """Return the effect of a camera that moves by `CAMERA_M`, shape (cycles, channels times bins)."""
        whole = np.zeros((len(self.numbers) * BINS, CHANNELS))
        (since,) = self._bins_before([candidate.cycle], [candidate.phase])
        whole[since:, POSITION] = CAMERA_M
        blocks = whole.reshape(len(self.numbers), BINS, CHANNELS).swapaxes(1, 2)
        return blocks.reshape(self.seen.shape)

    def unexplained(self) -> Array:
        """Return the weights of all residuals, assuming an unexplained deviation in each cycle in turn.

        The shape is (cycles, cycles, channels times bins).
        """
        spread = np.array(DEVIATION_SCATTER).repeat(BINS) ** 2
        weights = np.repeat(self.weight[None], len(self.numbers), axis=0)
        for k, usual in enumerate(self.weight):
            weights[k, k] = usual / (1.0 + spread * usual)
        return weights

    def _of_the_run(self) -> Array:
        """Return the effects of a healthy robot's differing parameters, which are the same in every cycle."""
        healthy = np.array(list(self.signs.healthy.values())).reshape(-1, 1, CHANNELS * BINS)
        return healthy.repeat(len(self.numbers), axis=1)

    def _of_a_cycle(self) -> Array:
        """Return the effects that vary independently from cycle to cycle."""
        channels = np.diag(np.array(SCATTER) * SHIFT).repeat(BINS, axis=1)
        thresholds = THRESHOLDS * self.signs.healthy["switching_threshold"].ravel()
        changes = np.kron(np.eye(len(self.numbers)), np.vstack([channels, thresholds]))
        return np.asarray(changes, np.float64).reshape(-1, *self.seen.shape)

    def _reported(self, reported: Sequence[ReportedCause]) -> Iterator[Array]:
        """Yield the effects of the causes already reported."""
        for event in reported:
            if event.name in self.signs.lasting:
                begun = Candidate(LASTING[event.name].up, event.name, event.cycle, 0.0, event.phase)
                for variant in range(len(self.signs.lasting[event.name])):
                    yield BROAD * self.lasting([begun._replace(variant=variant)])[0]
                if event.name == "viscous_friction":  # its effect on the power is not linear
                    yield self.lasting([begun._replace(name="scale")])[0]
            elif event.name == "missed":
                for fin in self.signs.missed:
                    yield self._grooves(fin, False, [event.cycle])
            elif event.name == "gained":
                for fin in self.signs.gained:
                    yield self._grooves(fin, True, [event.cycle])

    def _bins_before(self, numbers: Sequence[int], phases: Sequence[float]) -> NDArray[np.int64]:
        """Return the numbers of bins before phases of cycles, (n,) each, counted over all remembered cycles."""
        within = np.rint(np.array(phases) * BINS) * np.isin(numbers, self.numbers)
        return np.searchsorted(self.numbers, numbers) * BINS + within.astype(np.int64)

    def _grooves(self, fin: str, gained: bool, numbers: Iterable[int]) -> Array:  # noqa: FBT001
        """Return the effect of a fin that misses or gains a groove in each of the given cycles.

        The effect begins in the cycle before the given one. ``fin`` is a key of `Signatures.missed` or ``gained``.
        """
        whole = np.zeros_like(self.seen)
        before, after = (self.signs.gained if gained else self.signs.missed)[fin]
        for number in numbers:
            for cycle, change in ((number - 1, before), (number, after)):
                if cycle in self.numbers:
                    whole[self.numbers.index(cycle)] += change.ravel()
        return whole


def _offsets(signs: Signatures) -> Array:
    """Return the standard deviations of the offsets that are the same in all cycles, shape (CHANNELS, BINS)."""
    scatter = np.tile(np.array(SCATTER)[:, None], BINS)
    scatter[POWER] += POWER_SHARE * signs.power
    return scatter


def model_error(cycle: CycleData, signs: Signatures) -> tuple[float, ...]:
    """Return the root mean square of the residuals that no lasting cause explains, by channel, at least 1.

    It is relative to the offsets of a healthy robot. A robot that the model does not contain, for example with a
    compliant cable, deviates by the same large amounts in every cycle. Power alone cannot distinguish this from a
    cause, so that no cause explains it then.
    """
    offsets = _offsets(signs)
    variance = cycle.variance + offsets**2
    some = np.isfinite(variance)
    root = 1.0 / np.sqrt(variance[some])
    shifts = np.diag(np.array(SCATTER) * SHIFT).repeat(BINS, axis=1).reshape(-1, CHANNELS, BINS)
    usual = root * np.array([change[some] for change in (*signs.healthy.values(), *shifts)])
    tracked = some[:POWER].any()
    changes = BROAD * np.concatenate(list(signs.lasting.values()))
    single = [*changes, *(length.change for length in signs.lengths)] if tracked else []
    causes = root * np.array([cause[some] for cause in (np.zeros_like(offsets), *single)])
    seen = root * cycle.values[some]
    inner = np.eye(len(usual)) + usual @ usual.T
    own = causes - np.linalg.solve(inner, usual @ causes.T).T @ usual
    size = own @ seen / (1.0 + (own * causes).sum(axis=1))
    unexplained = seen - np.linalg.solve(inner, usual @ seen) @ usual - size[:, None] * own
    least = unexplained[(unexplained**2).sum(axis=1).argmin()]
    left = np.zeros_like(offsets)
    left[some] = (least / root) ** 2 - cycle.variance[some]
    ratio = left.sum(axis=1) / np.maximum(some.sum(axis=1), 1) / np.mean(offsets**2, axis=1)
    return tuple(np.sqrt(np.maximum(ratio, 1.0)).tolist())


def _excess(values: Array, variance: Array) -> Array:
    """Return the ratio of observed to expected variance between cycles for each channel, at least 1.

    It is the lower median over all pairs of successive cycles, so that a single change does not count as scatter.
    """
    expected = variance[:-1] + variance[1:]
    seen = np.isfinite(expected).sum(axis=2)  # (pairs, channels)
    ratios = (np.diff(values, axis=0) ** 2 / expected).sum(axis=2) / np.maximum(seen, 1)
    excess = np.ones(CHANNELS)
    for channel, (own, some) in enumerate(zip(ratios.T, (seen > 0).T, strict=True)):
        if some.sum() > 1:
            excess[channel] = max(1.0, np.sort(own[some])[(some.sum() - 1) // 2])
    return excess


def _lasting(cycles: Sequence[CycleData], signs: Signatures) -> Iterator[Candidate]:
    """Yield lasting causes that begin at each of `ONSETS` in each cycle."""
    for name, changes in signs.lasting.items():
        code, prior = LASTING[name].up, math.log(CHANGE / len(ONSETS) / len(changes))
        for variant in np.flatnonzero(changes.any(axis=(1, 2))).tolist():
            for cycle in cycles:
                for phase in ONSETS:
                    yield Candidate(code, name, cycle.number, prior, phase, variant=variant)


def _grooves(
    cycles: Sequence[CycleData], reported: Sequence[ReportedCause], signs: Signatures
) -> Iterator[Candidate]:
    """Yield candidates for grooves that a fin missed or gained in consecutive cycles.

    Near an edge a healthy robot misses or gains grooves more often. Cycles are excluded if the tracker saw that no
    groove was missed or gained, or if one was already reported.
    """
    settled = {cycle.number for cycle in cycles if cycle.step is not None and not cycle.gained}
    settled |= {event.cycle for event in reported if event.name in ("missed", "gained")}
    last = cycles[-1].number
    kinds = [(MISSED_BY_FIN[fin], fin, MISS, 1.0 / len(signs.missed)) for fin in signs.missed]
    kinds += [
        (GAINED, fin, 2.0 * GAIN / len(signs.gained), 1.0 / len(signs.gained))
        for fin in signs.gained
    ]
    for code, fin, chance, share in kinds:
        at_edge = {c.number: c.at_edge(1 if code == GAINED else -1) for c in cycles}
        at_edge[last + 1] = at_edge[last]
        for first in range(cycles[0].number, last + 2):
            log_prior, healthy = math.log(chance + share * at_edge.get(first, 0.0)), True
            for count in range(1, last + 3 - first):
                number = first + count - 1
                if number in settled:
                    break
                usual = at_edge.get(number, 0.0)
                log_prior += math.log(max(AGAIN, usual)) if count > 1 else 0.0
                healthy = healthy and usual > 0.0
                yield Candidate(
                    code, fin, first, log_prior, cycles=count, fact=True, healthy=healthy
                )


def _lengths(cycles: Sequence[CycleData], signs: Signatures) -> Iterator[tuple[Candidate, Array]]:
    """Yield candidates with another L0, each with its effect on all cycles."""
    errors = np.array([length.error for length in signs.lengths])
    density = np.exp(-0.5 * (errors / LENGTH_SPREAD_M) ** 2)
    density *= WRONG_LENGTH / max(float(density.sum()), L0_STEP_M)
    for length, chance in zip(signs.lengths, density.tolist(), strict=True):
        prior = math.log(chance)
        before = 0
        for cycle in cycles:
            if cycle.step is None:
                continue
            usual = RIGHT if cycle.gained == 0 else (AGAIN if before else 2.0 * MISS)
            usual = max(usual, cycle.at_edge(cycle.gained))
            prior += math.log(RIGHT if cycle.gained == length.gained else 1.0 - RIGHT)
            prior -= math.log(usual)
            before = cycle.gained
        candidate = Candidate(
            INITIAL_LENGTH, "", cycles[0].number, prior, fact=True, error=length.error
        )
        yield candidate, np.tile(length.change.ravel(), (len(cycles), 1))
