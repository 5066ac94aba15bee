# SPDX-License-Identifier: Apache-2.0
"""Settings of an optimisation, and the table from which its command-line options and node parameters are generated."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NoReturn

import numpy as np

from worm_model.errors import InputError
from worm_msgs.conditions import CONDITION_ROWS, Conditions
from worm_msgs.gait import (
    CONTRACTION_SHARE_RANGE,
    MAX_FREQUENCY,
    MAX_MARGIN,
    MAX_PRETENSION,
    MAX_STROKE,
    RAMP_SHARE_RANGE,
)
from worm_msgs.parameter_rows import ParameterRow
from worm_msgs.servo_models import SERVO_MODELS
from worm_msgs.settings_file import key
from worm_optimizer.evaluation.actuator_limits import ActuatorLimits
from worm_optimizer.evaluation.servo_limits import within
from worm_optimizer.evaluation.task import Array, Bounds
from worm_optimizer.search.corners import ShapeBounds
from worm_optimizer.search.exact import Resolution

_MOST_MARGINS = 10_000  # largest number of margins of a scan

PARAMETER_FILE = "parameter_file"


@dataclass(frozen=True)
class ScanSettings:
    """Margins of a margin scan: from the lowest to the highest in equal steps."""

    lowest: Annotated[float, key("lowest_m")] = 0.0
    highest: Annotated[float, key("highest_m")] = 8e-3
    step: Annotated[float, key("step_m")] = 1e-4

    def __post_init__(self) -> None:
        if not (0.0 <= self.lowest < self.highest <= MAX_MARGIN and self.step > 0.0):
            raise InputError(
                f"scan: from {self.lowest} to {self.highest} m by {self.step} m: "
                f"give 0 <= lowest < highest <= {MAX_MARGIN:g} m and a positive step"
            )
        if (self.highest - self.lowest) / self.step > _MOST_MARGINS:
            raise InputError(
                f"scan: a step of {self.step:g} m results in more than {_MOST_MARGINS} margins: give a larger step"
            )

    def margins(self) -> Array:
        """Return the margins in m. The last one is ``highest``, or lies less than a step below it."""
        count = int(np.floor((self.highest - self.lowest) / self.step + 1e-9)) + 1
        # Rounded to picometres, so that 3.4 mm is 0.0034 and not 0.0034000000000000002.
        return np.round(self.lowest + self.step * np.arange(count), 12)


@dataclass(frozen=True)
class Nsga2Settings:
    """Settings of NSGA-II: population, generations and the seed of its random numbers."""

    population: int = 100
    generations: int = 100
    seed: int = 1

    def __post_init__(self) -> None:
        if not (4 <= self.population <= 100_000 and 1 <= self.generations <= 100_000):
            raise InputError(
                f"search: population {self.population} and generations {self.generations}: "
                "give a population of at least 4 and at least 1 generation, both at most 100000"
            )
        if not 0 <= self.seed < 2**32:
            raise InputError(f"search: seed {self.seed}: give one from 0 to {2**32 - 1}")


class _Choice(enum.StrEnum):
    """Enumeration whose unknown names are rejected with the known ones."""

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise InputError(f"{cls.__name__.lower()}: {value!r} is none of {', '.join(cls)}")


class Robustness(_Choice):
    """Criterion that keeps gaits away from the edges of their branch."""

    MARGIN = "margin"  # the paper's enlarged threshold
    CHANCE = "chance"  # a gait keeps its grooves with a given probability at the known groove phase
    ANY_PHASE = "any_phase"  # a gait keeps its grooves at every groove phase


class Waveform(_Choice):
    """Waveforms among which a search chooses."""

    SINUSOID = "sinusoid"  # the paper's waveform
    SHAPED = "shaped"  # any pretension, contraction share, profile and ramp share within bounds


@dataclass(frozen=True)
class Settings:
    """Settings of an optimisation.

    Attributes:
        bounds: box of strokes and frequencies.
        limits: limits of the actuators.
        resolution: resolution of the survey.
        scan: margins of the margin scan.
        robustness: criterion of robustness.
        margin: margin, m. If both this and ``margin_force`` are None, `Robustness.MARGIN` uses the last margin of the
            scan before the cliff.
        probability: probability for `Robustness.CHANCE`.
        samples: number of Monte Carlo draws of a success probability.
        seed: seed of all draws.
        conditions: conditions in the pipe.
        waveform: waveforms among which the search chooses.
        shapes: bounds of shaped gaits.
        margin_force: margin, given as the load in N that a slow gait with this margin tolerates; see
            `front.given_margin`.
    """

    bounds: Bounds = field(default_factory=Bounds)
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)
    resolution: Resolution = field(default_factory=Resolution)
    scan: ScanSettings = field(default_factory=ScanSettings)
    robustness: Robustness = Robustness.MARGIN
    margin: float | None = None
    probability: float = 0.95
    samples: int = 500
    seed: int = 1
    conditions: Conditions = field(default_factory=Conditions)
    waveform: Waveform = Waveform.SINUSOID
    shapes: ShapeBounds = field(default_factory=ShapeBounds)
    margin_force: float | None = None

    @property
    def scans_margins(self) -> bool:
        """True if the margin is the last one before the cliff, which a margin scan finds."""
        given = self.margin is not None or self.margin_force is not None
        return self.robustness is Robustness.MARGIN and not given

    def with_margin(self, margin: float) -> Settings:
        """Return these settings with a margin in m instead of the one that they contain."""
        return replace(self, margin=margin, margin_force=None)

    def __post_init__(self) -> None:
        if self.margin_force is not None and not 0.0 <= self.margin_force < math.inf:
            raise InputError(
                f"margin_force: {self.margin_force} N: give a finite number that is not negative"
            )
        if self.margin is not None and self.margin_force is not None:
            raise InputError("margin: is given both in m and as a load in N; give one of them")
        if self.waveform is Waveform.SHAPED and self.robustness is not Robustness.MARGIN:
            raise InputError(
                f"robustness: {self.robustness.value} needs waveform sinusoid. Use this waveform, or robustness margin"
            )
        if self.margin is not None and not 0.0 <= self.margin <= MAX_MARGIN:
            raise InputError(
                f"margin: {self.margin} m is not between 0 and {MAX_MARGIN:g} m; "
                "without it, the last margin of the scan before the cliff is used"
            )
        if not (1 <= self.samples <= 1_000_000 and 0 <= self.seed < 2**32):
            raise InputError(
                f"samples {self.samples} and seed {self.seed}: "
                f"give 1 to 1000000 samples and a seed from 0 to {2**32 - 1}"
            )


@dataclass(frozen=True, kw_only=True)
class SettingRow(ParameterRow):
    """Setting: a parameter of the node, an option of the commands, and a row of the docs.

    Attributes:
        option: name of the commands' option. Two rows with the same option are the two values of this option.
        choices: admissible texts; empty if all are admissible.
    """

    option: str
    choices: tuple[str, ...] = ()


def _row(
    name: str,
    option: str,
    default: Any,
    description: str,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> SettingRow:
    """Return a setting. Only the conditions may be changed while the node runs."""
    read_only = name not in CONDITION_ROWS
    row = name, default, description, low, high, read_only
    return SettingRow(*row, option=option, choices=choices)


_BOX, _SCAN, _PLAIN, _SHAPES = Bounds(), ScanSettings(), Settings(), ShapeBounds()
_CONDITIONS = tuple(
    _row(
        name,
        row["option"].removeprefix("--"),
        0.0,
        f"{row['meaning']}, {row['unit']}",
        row["low"],
        row["high"],
    )
    for name, row in CONDITION_ROWS.items()
)
# The rows of each part of the settings, in the order of its fields
_BOX_ROWS = (
    _row("stroke_low_m", "strokes", _BOX.stroke_low, "least stroke, m", 1e-4, MAX_STROKE),
    _row("stroke_high_m", "strokes", _BOX.stroke_high, "greatest stroke, m", 1e-4, MAX_STROKE),
    _row("frequency_low_hz", "frequencies", _BOX.frequency_low, "least frequency, Hz", 1e-3, MAX_FREQUENCY),
    _row("frequency_high_hz", "frequencies", _BOX.frequency_high, "greatest frequency, Hz", 1e-3, MAX_FREQUENCY),
)  # fmt: skip
_LIMIT_ROWS = (
    _row("limits.max_cable_speed_m_per_s", "max-cable-speed", 0.0, "greatest cable speed, m/s; 0: no limit", 0.0,
         100.0),
    _row("limits.max_cable_force_n", "max-cable-force", 0.0, "greatest cable force, N; 0: no limit", 0.0, 1e5),
    _row("limits.max_power_w", "max-power", 0.0, "greatest source power, W; 0: no limit", 0.0, 1e5),
    _row("limits.max_push_force_n", "max-push-force", 0.0, "greatest force with which the cable may push in the model, "
         "N; 0: no limit", 0.0, 1e5),
)  # fmt: skip
_DRIVER_ROWS = (
    _row("limits.driver_file", "limits-from", "", "the driver's parameter file, whose limits apply too; empty: none"),
    _row("limits.servo_model", "servo-model", "", "with the driver's file, the model of the cable servos: "
         f"{', '.join(row.name for row in SERVO_MODELS)}; empty: unknown"),
    _row("limits.supply_voltage_v", "supply-voltage", 0.0, "with the driver's file, the supply voltage of the servos, "
         "V; 0: the voltage that their manual recommends", 0.0, 100.0),
)  # fmt: skip
_WAVEFORM_ROW = _row(
    "waveform",
    "waveform",
    Waveform.SINUSOID.value,
    "waveforms that are searched: the paper's (sinusoid), or all "
    "with pretension, contraction share, profile and ramp share within bounds (shaped)",
    choices=tuple(kind.value for kind in Waveform),
)
_SHAPE_ROWS = (
    _row("pretension_low_m", "pretensions", _SHAPES.pretension[0], "least pretension of shaped gaits, m", 0.0,
         MAX_PRETENSION),
    _row("pretension_high_m", "pretensions", _SHAPES.pretension[1], "greatest pretension, m; the greatest stroke "
         "bounds pretension and stroke together", 0.0, MAX_PRETENSION),
    _row("contraction_share_low", "contraction-shares", _SHAPES.contraction_share[0], "least contraction share of "
         "shaped gaits", *CONTRACTION_SHARE_RANGE),
    _row("contraction_share_high", "contraction-shares", _SHAPES.contraction_share[1], "greatest contraction share",
         *CONTRACTION_SHARE_RANGE),
    _row("ramp_share_low", "ramp-shares", _SHAPES.ramp_share[0], "least ramp share of shaped gaits", *RAMP_SHARE_RANGE),
    _row("ramp_share_high", "ramp-shares", _SHAPES.ramp_share[1], "greatest ramp share", *RAMP_SHARE_RANGE),
)  # fmt: skip
_SCAN_ROWS = (
    _row("scan_lowest_m", "lowest", _SCAN.lowest, "least margin of the scan, m", 0.0, MAX_MARGIN),
    _row("scan_highest_m", "highest", _SCAN.highest, "greatest margin of the scan, m", 0.0, MAX_MARGIN),
    _row("scan_step_m", "step", _SCAN.step, "step between the margins of the scan, m", 1e-6, MAX_MARGIN),
)  # fmt: skip
#: Box of gaits and limits of the robot
LIMIT_SETTINGS = (*_BOX_ROWS, *_LIMIT_ROWS, *_DRIVER_ROWS)
# Settings of a margin scan, which also apply to a front
SCAN_SETTINGS = (*LIMIT_SETTINGS, *_CONDITIONS, _WAVEFORM_ROW, *_SHAPE_ROWS, *_SCAN_ROWS)
FRONT_SETTINGS: tuple[SettingRow, ...] = (
    _row("margin_m", "margin", math.nan, "robustness margin, m; NaN or not given: the last margin of the scan before "
         "the cliff"),
    _row("margin_n", "margin-n", math.nan, "robustness margin, given as the load that it allows for, N"),
    _row("robustness", "robustness", Robustness.MARGIN.value, "criterion of robustness: an enlarged switching "
         "threshold (margin), a given probability that the gait gains its grooves (chance), or that it gains them at "
         "every groove phase (any_phase)", choices=tuple(kind.value for kind in Robustness)),
    _row("probability", "probability", _PLAIN.probability, "for robustness chance: lowest admissible probability "
         "that the gait gains its grooves", 0.0, 1.0),
    _row("seed", "seed", _PLAIN.seed, "seed of the Monte Carlo draws, and of NSGA-II", 0, 2**32 - 1),
    _row("samples", "samples", _PLAIN.samples, "number of draws of the parameters for a success probability", 1,
         1_000_000),
)  # fmt: skip
SETTINGS = (*SCAN_SETTINGS, *FRONT_SETTINGS)


def rows() -> list[ParameterRow]:
    """Return the parameters of the node."""
    file = ParameterRow(PARAMETER_FILE, "", "Parameter file; empty: the paper's values.")
    return [file, *SETTINGS]


def settings_of(values: Mapping[str, Any]) -> Settings:
    """Return the settings from values by name. A missing value is the default of its row.

    Raises `InputError` if the values are inadmissible or inconsistent.
    """
    value = {row.name: row.default for row in SETTINGS} | dict(values)

    def of(rows: Sequence[SettingRow]) -> list[Any]:
        return [value[row.name] for row in rows]

    speed, force, power, push = (limit or math.inf for limit in of(_LIMIT_ROWS))
    file, model, voltage = of(_DRIVER_ROWS)
    bounds, limits = within(
        Bounds(*of(_BOX_ROWS)),
        ActuatorLimits(speed, force, power, pushing_force=push),
        file,
        model,
        voltage or None,
    )
    shapes = of(_SHAPE_ROWS)
    return Settings(
        bounds=bounds,
        limits=limits,
        scan=ScanSettings(*of(_SCAN_ROWS)),
        robustness=Robustness(value["robustness"]),
        probability=value["probability"],
        margin=None if math.isnan(value["margin_m"]) else value["margin_m"],
        samples=value["samples"],
        seed=value["seed"],
        conditions=Conditions(**{name: value[name] for name in CONDITION_ROWS}),
        waveform=Waveform(value["waveform"]),
        shapes=ShapeBounds(*zip(shapes[::2], shapes[1::2], strict=True)),
        margin_force=None if math.isnan(value["margin_n"]) else value["margin_n"],
    )
