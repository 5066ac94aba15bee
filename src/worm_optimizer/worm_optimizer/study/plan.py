# SPDX-License-Identifier: Apache-2.0
"""Validated description of a study: the quantities that vary, the fixed ones, and the results to compute."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import ParameterFile
from worm_msgs.settings_file import OneOf, key
from worm_optimizer.evaluation.servo_limits import DrivenBy
from worm_optimizer.search.exact import Resolution as ScanResolution
from worm_optimizer.search.search_settings import ScanSettings, Waveform

Array = NDArray[np.float64]

# Names of the dimensions that do not belong to a single quantity
PARAMETER_FILE, SAMPLE = "parameter_file", "sample"
SOBOL, SALTELLI, LATIN_HYPERCUBE = "sobol", "saltelli", "latin_hypercube"
METHODS = (SOBOL, SALTELLI, LATIN_HYPERCUBE)
EXTENDABLE = (SOBOL, SALTELLI)  # methods with which more samples continue the same sequence
MOST_POINTS = 10_000_000  # largest number of points of a study
COMPUTABLE = ("front", "gaits", "cliff", "success", "any_phase")

# Nominal duration of a block, s. The client needs some 0.05 s to submit and store a block.
_BLOCK_SECONDS = 5.0
_FEWEST_BLOCKS = 20  # least number of blocks, so that the progress bar of a small study advances
# Nominal durations of a front, of an any-phase front and of one margin of a scan, on one core at the default
# resolution, s. They are constant, so that blocks have the same size on all computers.
_FRONT_SECONDS, _ANY_PHASE_SECONDS, _MARGIN_SECONDS = 0.5, 2.8, 0.03
_SHAPED = 15.0  # duration of a front or a scan of shaped gaits, relative to that of sinusoids
_DRAW_SECONDS = 2.5e-4  # nominal duration of one draw of a success probability, s


@dataclass(frozen=True)
class Axis:
    """Quantity that varies, over ``values`` (a grid) or sampled between ``low`` and ``high``."""

    name: str
    values: tuple[float, ...] = ()
    low: float = math.nan
    high: float = math.nan

    @property
    def sampled(self) -> bool:
        """True if the values are drawn, False if they are listed."""
        return not self.values


@dataclass(frozen=True)
class Sample:
    """Sampling of all axes with a range: ``method`` (one of `METHODS`), number of ``points`` and ``seed``.

    With `SALTELLI`, ``points`` is the number of base samples, each of which results in d + 2 points for d axes.
    """

    method: Annotated[str, OneOf(METHODS)] = SOBOL
    points: Annotated[int, key(ge=1, le=MOST_POINTS)] = 64
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    def size(self, axes: int) -> int:
        """Return the number of points for ``axes`` axes with a range."""
        return self.points * (axes + 2 if self.method == SALTELLI else 1)

    def draw(self, axes: int) -> Array:
        """Return values between 0 and 1, shape (size, axes).

        Sobol sequences are scrambled, because an unscrambled one begins with a point whose values are all exactly 0.
        With a method of `EXTENDABLE`, a larger sample begins with the points of a smaller one.
        """
        from scipy.stats import qmc  # here: the import takes a second, and workers do not need it

        if self.method == LATIN_HYPERCUBE:
            return qmc.LatinHypercube(axes, seed=self.seed).random(self.points)
        saltelli = self.method == SALTELLI
        engine: Any = qmc.Sobol(2 * axes if saltelli else axes, scramble=True, seed=self.seed)
        unit = engine.random_base2(math.ceil(math.log2(max(self.points, 2))))[: self.points]
        return _saltelli(unit[:, :axes], unit[:, axes:]) if saltelli else unit


def _saltelli(first: Array, second: Array) -> Array:
    """Return the rows A, B, AB_1 … AB_d of each base sample, one base sample after another.

    A is the row of the base sample in ``first``, and B its row in ``second``. AB_k is A with element k replaced by
    element k of B.
    """
    mixed = np.repeat(first[:, None], first.shape[1], axis=1)
    each = np.arange(first.shape[1])
    mixed[:, each, each] = second
    rows = np.concatenate([first[:, None], second[:, None], mixed], axis=1)
    return rows.reshape(-1, first.shape[1])


@dataclass(frozen=True)
class Hardware:
    """Limits from the parameter file of the ``driver``, ``model`` of the cable servos, and supply ``voltage`` in V.

    A value is None, and the model an empty string, if the study does not state it.
    """

    driver: DrivenBy | None = None
    model: str = ""
    voltage: float | None = None


@dataclass(frozen=True)
class Resolution:
    """Resolution of the computation of a point.

    Attributes:
        scan: grid of strokes and frequencies on which the search for edges starts.
        front_gaits: number of stored gaits of a front.
        samples: number of draws of a success probability.
        seed: seed of these draws.
    """

    scan: ScanResolution = field(default_factory=ScanResolution)
    front_gaits: int = 32
    samples: int = 500
    seed: int = 1


@dataclass(frozen=True)
class Study:
    """Validated description of a study.

    Attributes:
        title: title of the study.
        text: content of the YAML file.
        files: (name, content) of the parameter file of each robot.
        axes: quantities that vary.
        sample: sampling of the axes with a range.
        fixed: values of the quantities that do not vary.
        margin_at_cliff: True if each point uses the last margin before the cliff of its own scan.
        hardware: limits of driver and servos.
        compute: requested results, some of `COMPUTABLE`.
        resolution: resolution of the computation.
        scan: margins of the margin scan.
        block_points: largest number of points in a block.
        waveform: waveforms among which the search chooses.
    """

    title: str
    text: str
    files: tuple[tuple[str, ParameterFile], ...]
    axes: tuple[Axis, ...]
    sample: Sample
    fixed: Mapping[str, float]
    margin_at_cliff: bool
    hardware: Hardware
    compute: tuple[str, ...]
    resolution: Resolution
    scan: ScanSettings
    block_points: int
    waveform: Waveform

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the columns of `points`: `PARAMETER_FILE`, even for a single file, and the names of the axes."""
        return (PARAMETER_FILE, *(axis.name for axis in self.axes))

    @property
    def ranges(self) -> tuple[Axis, ...]:
        """Axes that are sampled."""
        return tuple(axis for axis in self.axes if axis.sampled)

    @property
    def dimensions(self) -> dict[str, Sequence[float]]:
        """Dimensions of the points with their values, the slowest-varying dimension first.

        Several parameter files form one dimension, each list of values another one, and the samples of all ranges
        together the last one.
        """
        values: dict[str, Sequence[float]] = {}
        if len(self.files) > 1:
            values[PARAMETER_FILE] = range(len(self.files))
        values |= {axis.name: axis.values for axis in self.axes if not axis.sampled}
        if self.ranges:
            values[SAMPLE] = range(self.sample.size(len(self.ranges)))
        return values

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points along each of `dimensions`."""
        return tuple(map(len, self.dimensions.values()))

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def points(self) -> Array:
        """Return the value of each of `varied` at each point, shape (*shape, len(varied)); for a file, its index."""
        mesh = np.meshgrid(*map(np.asarray, self.dimensions.values()), indexing="ij")
        columns = dict(zip(self.dimensions, mesh, strict=True))
        if self.ranges:
            drawn = self.sample.draw(len(self.ranges))
            for k, axis in enumerate(self.ranges):
                values = axis.low + drawn[:, k] * (axis.high - axis.low)
                columns[axis.name] = values[columns[SAMPLE]]
        columns.setdefault(PARAMETER_FILE, np.zeros(self.shape))
        return np.stack([columns[name].astype(float) for name in self.varied], axis=-1)

    def default_block_points(self) -> int:
        """Return the number of points in a block.

        Such a block takes about `_BLOCK_SECONDS`, or less if the study would otherwise have fewer than `_FEWEST_BLOCKS`
        blocks.
        """
        scan = self.resolution.scan
        share = scan.strokes * scan.frequencies / (41 * 161)
        seconds = 1e-3
        slower = _SHAPED if self.waveform is Waveform.SHAPED else 1.0
        if {"front", "gaits", "success"} & set(self.compute):
            seconds += slower * _FRONT_SECONDS * share
        if "cliff" in self.compute or self.margin_at_cliff:
            seconds += slower * _MARGIN_SECONDS * len(self.scan.margins())
        if "success" in self.compute:
            seconds += _DRAW_SECONDS * self.resolution.samples
        if "any_phase" in self.compute:
            seconds += _ANY_PHASE_SECONDS * share
        by_time = math.ceil(_BLOCK_SECONDS / seconds)
        return max(1, min(by_time, math.ceil(self.size / _FEWEST_BLOCKS)))
