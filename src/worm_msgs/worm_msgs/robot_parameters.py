# SPDX-License-Identifier: Apache-2.0
"""Table of the robot's parameters: key, default, unit, range and symbol, and the content of the parameter file.

No other module declares these parameters. The model, identification, the optimizer, the driver and the virtual robot
read them from here by key. To add a parameter, add a row. If the parameter acts on the robot, also add a term to the
equations of the simulator's kernel (`worm_model.simulation.kernel`) and of the virtual robot's motion
(`worm_driver.virtual_robot.plant`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from typing import Annotated, Any

from worm_msgs.settings_file import OneOf, key

STANDARD_GRAVITY = 9.80665  # m/s², exact by definition (CGPM 1901)


def _row(
    default: float,
    unit: str,
    low: float,
    high: float,
    paper: str,
    *,
    power_only: bool = False,
) -> float:
    """Return a row of the table, as a dataclass field.

    Args:
        default: the paper's value, except for L0; 0 for an effect that the paper's model does not contain.
        unit: SI unit of the value.
        low, high: admissible range, which `settings_file` checks. The range spans several orders of magnitude, so that
            it admits unusual robots and rejects most values in a wrong unit, such as mm for m.
        paper: symbol; the symbol of the paper if the quantity occurs in the paper.
        power_only: True if the value affects the power, but not the motion.
    """
    metadata = {"unit": unit, "low": low, "high": high, "paper": paper, "power_only": power_only}
    of_file = {"ge": low, "le": high, "description": f"{paper}, {unit}"}  # for pydantic.Field
    return field(default=default, metadata={**metadata, **of_file})


@dataclass(frozen=True)
class RobotParameters:
    """Parameters of the worm in its pipe, SI units.

    The defaults are those of the paper's table ``tab1``, but L0 is calibrated by this project (docs/model.md). Dry
    friction and loads are 0.
    """

    rear_mass: float = _row(0.429, "kg", 1e-3, 1e2, "M1")
    front_mass: float = _row(0.429, "kg", 1e-3, 1e2, "M2")
    unstressed_length: float = _row(0.300, "m", 1e-2, 1e1, "L_free", power_only=True)
    initial_length: float = _row(0.2952, "m", 1e-2, 1e1, "L0")
    bellows_stiffness: float = _row(968.8, "N/m", 1.0, 1e6, "k_b", power_only=True)
    bellows_damping: float = _row(862.4, "N·s/m", 0.0, 1e6, "c_b", power_only=True)
    viscous_friction: float = _row(86.97, "N·s/m", 1e-2, 1e5, "η")
    pitch: float = _row(0.0173, "m", 1e-3, 0.2, "d")
    engaged_stiffness: float = _row(1833.1, "N/m", 1.0, 1e6, "k_eng")
    disengaged_stiffness: float = _row(442.0, "N/m", 1.0, 1e6, "k_dis")
    switching_threshold: float = _row(0.0175, "m", 5e-4, 0.2, "p_sw")
    clearance: float = _row(0.00753, "m", 0.0, 0.1, "δ_c")
    time_constant: float = _row(0.155, "s", 1e-3, 1e1, "τ")
    gain: float = _row(0.860, "1", 1e-2, 1e1, "K")
    slack: float = _row(0.008, "m", 0.0, 0.1, "δ_s")
    idle_power: float = _row(0.82, "W", 0.0, 1e3, "P_idle", power_only=True)
    power_factor: float = _row(3.22, "1", 1e-2, 1e3, "α_P", power_only=True)
    rear_dry_friction: float = _row(0.0, "N", 0.0, 1e3, "D1")
    front_dry_friction: float = _row(0.0, "N", 0.0, 1e3, "D2")
    rear_load: float = _row(0.0, "N", -1e3, 1e3, "Q1")  # Q1, Q2: positive towards -x
    front_load: float = _row(0.0, "N", -1e3, 1e3, "Q2")

    @property
    def mass(self) -> float:
        """Total mass of both modules, kg."""
        return self.rear_mass + self.front_mass


def rows_of(table: type[RobotParameters]) -> list[Field[float]]:
    """Return the fields of `RobotParameters` or a subclass that are parameters of the robot.

    Fields that a subclass adds for other content of a parameter file are left out.
    """
    return [row for row in fields(table) if row.metadata]


ROWS: Mapping[str, Mapping[str, Any]] = {row.name: row.metadata for row in rows_of(RobotParameters)}
_Name = Annotated[str, OneOf(tuple(ROWS))]


@dataclass(frozen=True)
class TravelError:
    """Measured minus predicted margin (m) of a run, as a normal distribution: its mean and its standard deviation.

    A robot with the travel error e behaves as the model with a switching threshold that is lower by e.
    """

    value: float
    sd: Annotated[float, key(ge=0.0)]


@dataclass(frozen=True)
class ParameterFileContent(RobotParameters):
    """Content of a parameter file. A missing key means the default value.

    Attributes:
        one_sided_cable: True if c_b and α_P were fitted with the power model of a cable that cannot push, see
            `worm_model.parameters`.
        intervals: 95 % intervals (low, high) by key, in the key's unit.
        correlations: (key, key, correlation) of the errors of two keys.
        run_to_run: standard deviation with which the value of a key varies from run to run, by key, in the key's unit.
            The intervals hold for the means over the runs and do not include this variation.
        travel_error: difference between the measured and the predicted margin; None if no run has measured it.
        provenance: any content, such as bags and their hashes, code version and seed.
    """

    one_sided_cable: bool = False
    intervals: Mapping[_Name, tuple[float, float]] = field(default_factory=dict)
    correlations: tuple[tuple[_Name, _Name, Annotated[float, key(ge=-1.0, le=1.0)]], ...] = ()
    run_to_run: Mapping[_Name, Annotated[float, key(ge=0.0)]] = field(default_factory=dict)
    travel_error: TravelError | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError if the low end of an interval exceeds its high end, or a correlation names a key twice."""
        for name, (low, high) in self.intervals.items():
            if not low <= high:
                raise ValueError(f"intervals: {name}: low {low:g} is above high {high:g}")
        for first, second, _ in self.correlations:
            if first == second:
                raise ValueError(f"correlations: {first}, {second}: give two different keys")
