# SPDX-License-Identifier: Apache-2.0
"""Validated description of a study: the quantities that vary, the fixed ones, and the results to compute."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import ParameterFile
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import (
    CONTRACTION_SHARE_RANGE,
    MAX_FREQUENCY,
    MAX_MARGIN,
    MAX_PRETENSION,
    MAX_STROKE,
    RAMP_SHARE_RANGE,
)
from worm_msgs.robot_parameters import ROWS
from worm_msgs.settings_file import key
from worm_optimizer.code_version import code_identity
from worm_optimizer.evaluation.servo_limits import DrivenBy
from worm_optimizer.search.exact import Resolution as ScanResolution
from worm_optimizer.search.search_settings import ScanSettings, Waveform

Array = NDArray[np.float64]

# Names of the dimensions that do not belong to a single quantity
PARAMETER_FILE, SAMPLE = "parameter_file", "sample"
COMPUTABLE = ("front", "gaits", "cliff", "success", "any_phase")
MOST_POINTS = 1_000_000  # of a study, whose results are in memory at the end
_MOST_BLOCKS = 1000  # a killed study loses a thousandth of its time for each worker

_FINEST = 10_000  # largest number of strokes, frequencies or gaits of a front
_SMALL, _LARGE = 1e-6, 1e6  # bounds of positive quantities, in their units


@dataclass(frozen=True)
class Quantity:
    """Quantity: ``unit``, description, and admissible range. A value outside the range is probably in another unit."""

    unit: str
    long_name: str
    low: float
    high: float


_OTHERS: Mapping[str, Quantity] = {
    "margin_m": Quantity("m", "robustness margin", 0.0, MAX_MARGIN),
    "direction": Quantity("1", "direction: 1 forward, -1 reverse", -1.0, 1.0),
    "groove_phase_m": Quantity("m", "groove phase", -0.1, 0.1),
    "spool_radius_m": Quantity("m", "spool radius of the cable servos", 1e-3, 1.0),
    "min_stroke_m": Quantity("m", "shortest stroke", _SMALL, MAX_STROKE),
    "max_stroke_m": Quantity("m", "longest stroke", _SMALL, MAX_STROKE),
    "min_frequency_Hz": Quantity("Hz", "lowest frequency", _SMALL, MAX_FREQUENCY),
    "max_frequency_Hz": Quantity("Hz", "highest frequency", _SMALL, MAX_FREQUENCY),
    "max_cable_speed_m_per_s": Quantity("m/s", "highest cable speed", _SMALL, _LARGE),
    "max_cable_force_N": Quantity("N", "highest cable force", _SMALL, _LARGE),
    "max_power_W": Quantity("W", "highest source power", _SMALL, _LARGE),
    "stall_force_N": Quantity("N", "cable force at which the motors stall", _SMALL, _LARGE),
    "no_load_speed_m_s": Quantity("m/s", "cable speed of the motors without load", _SMALL, _LARGE),
    "max_push_force_N": Quantity("N", "highest pushing force in the model's cable", _SMALL, _LARGE),
    "holding_power_W_per_N": Quantity("W/N", "power for each N of the mean pull", 0.0, _LARGE),
    "min_pretension_m": Quantity("m", "least pretension", 0.0, MAX_PRETENSION),
    "max_pretension_m": Quantity("m", "greatest pretension", 0.0, MAX_PRETENSION),
    "min_contraction_share": Quantity("1", "least contraction share", *CONTRACTION_SHARE_RANGE),
    "max_contraction_share": Quantity("1", "greatest contraction share", *CONTRACTION_SHARE_RANGE),
    "min_ramp_share": Quantity("1", "least ramp share", *RAMP_SHARE_RANGE),
    "max_ramp_share": Quantity("1", "greatest ramp share", *RAMP_SHARE_RANGE),
    "at_power_W": Quantity("W", "power of the gait max_speed_at_power", _SMALL, _LARGE),
    "at_speed_m_s": Quantity("m/s", "speed of the gait min_power_at_speed", _SMALL, _LARGE),
    "reference_power_W": Quantity("W", "power up to which hypervolumes count", _SMALL, _LARGE),
}
LIMITS = (  # in the order of the fields of ActuatorLimits
    *("max_cable_speed_m_per_s", "max_cable_force_N", "max_power_W"),
    *("stall_force_N", "no_load_speed_m_s", "max_push_force_N"),
)
SHAPE_BOUNDS = (  # lower and upper end of each field of ShapeBounds, in the order of the fields
    ("min_pretension_m", "max_pretension_m"),
    ("min_contraction_share", "max_contraction_share"),
    ("min_ramp_share", "max_ramp_share"),
)
# Units in the notation of the CF conventions
_CF_UNITS = {"°": "degree", "deg": "degree", "m²": "m2", "N·s/m": "N s/m"}


def _described(row: Mapping, long_name: str) -> Quantity:
    unit = _CF_UNITS.get(row["unit"], row["unit"])
    return Quantity(unit, long_name, row["low"], row["high"])


#: Quantities that a study may vary or fix: keys of a parameter file, conditions in the pipe, and others.
QUANTITIES: Mapping[str, Quantity] = {
    **{k: _described(row, f"{k.replace('_', ' ')} ({row['paper']})") for k, row in ROWS.items()},
    **{k: _described(row, row["meaning"]) for k, row in CONDITION_ROWS.items()},
    **_OTHERS,
}


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
        strokes, frequencies: grid on which the search for edges starts, see `scan`.
        front_gaits: number of stored gaits of a front.
        samples: number of draws of a success probability.
        seed: seed of these draws.
    """

    strokes: Annotated[int, key(ge=3, le=_FINEST)] = ScanResolution.strokes
    frequencies: Annotated[int, key(ge=2, le=_FINEST)] = ScanResolution.frequencies
    front_gaits: Annotated[int, key(ge=3, le=_FINEST)] = 32
    samples: Annotated[int, key(ge=1, le=1_000_000)] = 500
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    @property
    def scan(self) -> ScanResolution:
        """Grid on which the search for edges starts."""
        return ScanResolution(self.strokes, self.frequencies)


@dataclass(frozen=True)
class Sample:
    """Sampling of all axes with a range: number of ``points`` and ``seed`` of the scrambled Sobol sequence."""

    points: Annotated[int, key(ge=1, le=MOST_POINTS)] = 64
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    def draw(self, axes: int) -> Array:
        """Return values between 0 and 1, shape (points, axes).

        The sequence is scrambled, because an unscrambled one begins with a point whose values are all exactly 0. A
        larger sample begins with the points of a smaller one.
        """
        from scipy.stats import qmc  # here: the import takes a second, and workers do not need it

        engine = qmc.Sobol(axes, scramble=True, seed=self.seed)
        return engine.random_base2(math.ceil(math.log2(max(self.points, 2))))[: self.points]


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
            values[SAMPLE] = range(self.sample.points)
        return values

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points along each of `dimensions`."""
        return tuple(map(len, self.dimensions.values()))

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    @property
    def block_points(self) -> int:
        """Largest number of points in a block."""
        return math.ceil(self.size / _MOST_BLOCKS)

    def points(self) -> Array:
        """Return the value of each of `varied` at each point, shape (size, len(varied)); for a file, its index."""
        mesh = np.meshgrid(*map(np.asarray, self.dimensions.values()), indexing="ij")
        columns = dict(zip(self.dimensions, mesh, strict=True))
        if self.ranges:
            drawn = self.sample.draw(len(self.ranges))
            for k, axis in enumerate(self.ranges):
                values = axis.low + drawn[:, k] * (axis.high - axis.low)
                columns[axis.name] = values[columns[SAMPLE]]
        columns.setdefault(PARAMETER_FILE, np.zeros(self.shape))
        return np.stack([columns[name].ravel().astype(float) for name in self.varied], axis=-1)

    def identity(self) -> str:
        """Return a hash of the code and of all that determines the results of a point with given values.

        Two studies that differ in title and points only have the same identity.
        """
        plain = dataclasses.replace(self, title="", text="", axes=(), sample=Sample())
        content = f"{code_identity()} {self.varied} {plain}"
        return hashlib.sha256(content.encode()).hexdigest()[:24]
