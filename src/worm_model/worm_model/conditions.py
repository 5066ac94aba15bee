# SPDX-License-Identifier: Apache-2.0
"""Conditions in the pipe (slope, tether, flow) and the loads on the modules that follow from them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from worm_model.errors import InputError
from worm_model.parameters import STANDARD_GRAVITY, ParameterFile, Parameters

WATER_DENSITY = 998.2  # kg/m³ at 20 °C


class ConditionsError(InputError):
    """A condition is not admissible. The message names it and the reason."""


def _row(option: str, unit: str, low: float, high: float, meaning: str) -> float:
    """Return a field with the default 0 and the arguments as metadata; ``option`` is its command-line option."""
    metadata = {"option": option, "unit": unit, "low": low, "high": high, "meaning": meaning}
    return dataclasses.field(default=0.0, metadata=metadata)


@dataclass(frozen=True)
class Conditions:
    """Slope, tether and flow of a pipe. A force is positive towards −x, that is against a forward gait.

    The tether is attached to the rear module. The force of the tether is ``tether_N`` plus ``tether_N_per_m`` for each
    metre of ``distance_m``, the length of tether in the pipe. During a run this length is assumed to be constant.

    The water flows towards −x with ``flow_m_per_s``. ``drag_area_m2`` is C_d·A of each module. Drag is linearised about
    the resting robot, see `under`.

    Raises `ConditionsError` if a value is not finite or not in its range, or if it has no effect because the value with
    which it is multiplied is 0.
    """

    slope_deg: float = _row("--slope", "deg", -90.0, 90.0, "slope of the pipe, uphill towards +x")
    tether_N: float = _row("--tether", "N", -1e3, 1e3, "force of the tether on the rear module")  # noqa: N815
    tether_N_per_m: float = _row(  # noqa: N815
        "--tether-per-metre", "N/m", 0.0, 1e3, "further force for each metre of tether"
    )
    distance_m: float = _row("--tether-length", "m", 0.0, 1e4, "length of tether in the pipe")
    flow_m_per_s: float = _row(
        "--flow", "m/s", -10.0, 10.0, "velocity of the water, positive towards -x"
    )
    drag_area_m2: float = _row(
        "--drag-area", "m2", 0.0, 1.0, "drag coefficient times area of each module"
    )

    def __post_init__(self) -> None:
        for row in dataclasses.fields(self):
            value, unit = getattr(self, row.name), row.metadata["unit"]
            low, high = row.metadata["low"], row.metadata["high"]
            if not low <= value <= high:
                raise ConditionsError(
                    f"{row.name}: {value} {unit} is not between {low:g} and {high:g} {unit}"
                )
        for one, other in (("tether_N_per_m", "distance_m"), ("flow_m_per_s", "drag_area_m2")):
            given, missing = (one, other) if getattr(self, one) else (other, one)
            if getattr(self, given) and not getattr(self, missing):
                raise ConditionsError(
                    f"{given}: {getattr(self, given):g} has no effect without {missing}; give both"
                )

    def __str__(self) -> str:
        """Return the values that are not zero as text, such as ``slope 20 deg, tether 2 N``, or ``level ground``."""
        text = ", ".join(
            f"{row['option'].strip('-').replace('-', ' ')} {value:g} {row['unit']}"
            for name, row in CONDITION_ROWS.items()
            if (value := getattr(self, name))
        )
        return text or "level ground"

    @property
    def tether(self) -> float:
        """Force of the tether at ``distance_m``, N."""
        return self.tether_N + self.tether_N_per_m * self.distance_m


LEVEL = Conditions()
CONDITION_ROWS: Mapping[str, Mapping[str, Any]] = {
    row.name: row.metadata for row in dataclasses.fields(Conditions)
}
#: field of `Conditions` by its name in lower case, as in ROS parameters, system.yaml and the manifest of a recording
CONDITION_PARAMETERS: Mapping[str, str] = {name.lower(): name for name in CONDITION_ROWS}


def conditions_of(source: Any) -> Conditions:
    """Return the conditions from the attributes of an object, such as parsed options. A missing attribute means 0."""
    return Conditions(**{name: getattr(source, name, 0.0) for name in CONDITION_ROWS})


def under(conditions: Conditions, parameters: Parameters) -> Parameters:
    """Return the parameters of a robot under conditions; `LEVEL` leaves the parameters unchanged.

    The load on each module increases by its weight along the pipe and by its drag at rest. The load on the rear module
    also increases by the force of the tether. With the density ρ and the velocity U of the water, the drag of a module
    with the velocity x′ is ρ/2·C_dA·(U + x′)·|U + x′|. The derivative of the drag at x′ = 0, ρ·C_dA·|U|, is added to
    the viscous friction. The remaining part of the drag, ρ/2·C_dA·x′², and buoyancy are neglected.

    Raises `ParameterError` if a load or the friction is then outside its range.
    """
    weight = STANDARD_GRAVITY * math.sin(math.radians(conditions.slope_deg))
    drag = WATER_DENSITY * conditions.drag_area_m2 * abs(conditions.flow_m_per_s)
    resting = 0.5 * drag * conditions.flow_m_per_s
    return parameters.replace(
        rear_load=parameters.rear_load
        + parameters.rear_mass * weight
        + conditions.tether
        + resting,
        front_load=parameters.front_load + parameters.front_mass * weight + resting,
        viscous_friction=parameters.viscous_friction + drag,
    )


def content_under(conditions: Conditions, content: ParameterFile) -> ParameterFile:
    """Return the content of a parameter file under conditions; the interval of a parameter moves with its value.

    Raises `ParameterError` as `under` does.
    """
    if conditions == LEVEL:
        return content
    parameters = under(conditions, content.parameters)
    before, after = content.parameters.as_dict(), parameters.as_dict()
    intervals = {
        key: (low + after[key] - before[key], high + after[key] - before[key])
        for key, (low, high) in content.intervals.items()
    }
    return dataclasses.replace(content, parameters=parameters, intervals=intervals)
