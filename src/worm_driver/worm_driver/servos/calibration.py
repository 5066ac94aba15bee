# SPDX-License-Identifier: Apache-2.0
"""Results of a calibration: spools from ruler readings, and the driver's parameter file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import linear_regression

import yaml

from worm_driver.driver_errors import ConfigurationError
from worm_driver.servos.registers import TICKS_PER_TURN
from worm_driver.servos.transmission import Fin, Spool

#: Largest accepted deviation of a ruler reading from the straight line through all readings, m.
_SCATTER = 1.5e-3
#: Smallest difference between the longest and the shortest reading from which a radius is computed, m.
_LEAST_CHANGE = 5e-3


@dataclass(frozen=True)
class Reading:
    """Position of a cable servo (ticks), and the body length (m) that the ruler shows at this position."""

    ticks: int
    length: float


def spool_from(servo: int, readings: Sequence[Reading]) -> tuple[Spool, float]:
    """Return the spool that fits the readings best, and the largest deviation of a reading from the fit (m).

    The fit is a straight line: the length (m) as a function of the servo angle (rad). The absolute value of its slope
    is the radius of the spool (m). If the length falls with rising ticks, the sign is 1, otherwise -1.
    """
    if len({reading.ticks for reading in readings}) < 2:
        raise ConfigurationError(
            f"cable servo {servo}: at least two different positions are needed"
        )
    angles = [reading.ticks * 2 * math.pi / TICKS_PER_TURN for reading in readings]
    lengths = [reading.length for reading in readings]
    if max(lengths) - min(lengths) < _LEAST_CHANGE:
        raise ConfigurationError(
            f"cable servo {servo}: the body length changed by less than {_LEAST_CHANGE * 1e3:g} mm: "
            "is the cable attached and taut?"
        )
    slope, start = linear_regression(angles, lengths)
    worst = max(abs(x - start - slope * a) for a, x in zip(angles, lengths, strict=True))
    if worst > _SCATTER:
        raise ConfigurationError(
            f"cable servo {servo}: a reading is {worst * 1e3:.1f} mm off the straight line through all "
            "readings: start where the cable is taut, and read again"
        )
    return Spool(servo, -1 if slope > 0 else 1, round(abs(slope), 5)), worst


def parameter_text(port: str, baud_rate: int, spools: Sequence[Spool], fins: Sequence[Fin]) -> str:
    """Return the text of the driver's parameter file with the calibrated values.

    Parameters that are not in the text keep their defaults.
    """
    parameters: dict[str, object] = {
        "port": port,
        "baud_rate": baud_rate,
        "cable_servos": {
            "ids": [spool.servo for spool in spools],
            "signs": [spool.sign for spool in spools],
            "spool_radius_m": [spool.radius for spool in spools],
        },
        "fin_servos": {
            "ids": [fin.servo for fin in fins],
            "forward_angle_rad": [round(fin.forward_angle, 4) for fin in fins],
            "reverse_angle_rad": [round(fin.reverse_angle, 4) for fin in fins],
        },
    }
    body = yaml.safe_dump(
        {"/**/driver": {"ros__parameters": parameters}}, sort_keys=False, default_flow_style=None
    )
    return f"# Written by `worm_driver calibrate`; every other parameter keeps its default.\n{body}"
