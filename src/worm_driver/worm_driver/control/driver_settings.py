# SPDX-License-Identifier: Apache-2.0
"""Validated driver configuration."""

import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

from worm_driver.driver_errors import ConfigurationError
from worm_driver.gait.gait_player import PlayerSettings
from worm_driver.servos.registers import COMMON
from worm_driver.servos.transmission import Fin, Spool
from worm_msgs.driver_file import DriverFile
from worm_msgs.robot_parameters import ParameterFileContent, RobotParameters
from worm_msgs.settings_file import read_settings

#: ROS names of the parameters, by their names in `DriverFile`.
PARAMETER_NAMES = {row.name: row.metadata["alias"] for row in fields(DriverFile)}


@dataclass(frozen=True)
class DriverSettings(DriverFile):
    """Parameters of one driver that agree with each other, and what follows from them, in SI units.

    Attributes:
        body: parameters of the robot and its pipe.

    Raises:
        ConfigurationError: Parameters contradict each other.
    """

    body: RobotParameters = field(default_factory=RobotParameters)

    def __post_init__(self) -> None:
        if not self.cable_ids:
            raise ConfigurationError("there is no cable servo: set cable_servos.ids")
        self._require_entries("cable_ids", "cable_signs", "spool_radii")
        self._require_entries("fin_ids", "forward_angles", "reverse_angles")
        ids = [spool.servo for spool in self.spools] + [fin.servo for fin in self.fins]
        for number in ids:
            if not 0 <= number <= 252:
                raise ConfigurationError(f"servo id {number} is not in 0 to 252")
            if ids.count(number) > 1:
                raise ConfigurationError(f"two servos have the id {number}")
        step = COMMON["bus_watchdog"].scale
        if not math.isclose(self.watchdog, step * round(self.watchdog / step)):
            raise ConfigurationError(
                f"bus_watchdog_s is {self.watchdog:g}, and the servos count in steps of {step:g} s: use a multiple"
            )
        if self.period >= self.watchdog:
            raise ConfigurationError(
                f"rate_hz is {self.rate:g}: the servos stop by their watchdog (bus_watchdog_s, {self.watchdog:g} s) "
                f"between two cycles. Use a rate above {1.0 / self.watchdog:g} Hz, or a longer watchdog"
            )

    def _require_entries(self, *names: str) -> None:
        """Raise ConfigurationError if parameters do not have one entry per servo each."""
        counts = {PARAMETER_NAMES[name]: len(getattr(self, name)) for name in names}
        if len(set(counts.values())) > 1:
            lengths = ", ".join(f"{name} has {count}" for name, count in counts.items())
            raise ConfigurationError(f"these parameters need one entry per servo: {lengths}")

    @cached_property
    def spools(self) -> tuple[Spool, ...]:
        """Spools of the cable servos."""
        return tuple(map(Spool, self.cable_ids, self.cable_signs, self.spool_radii))

    @cached_property
    def fins(self) -> tuple[Fin, ...]:
        """Fin servos."""
        return tuple(map(Fin, self.fin_ids, self.forward_angles, self.reverse_angles))

    @property
    def period(self) -> float:
        """Period of the control cycle, s."""
        return 1.0 / self.rate

    @cached_property
    def player(self) -> PlayerSettings:
        """Times and speeds of the gait player."""
        return PlayerSettings(
            rest_duration=self.rest_duration,
            rest_samples=10 if self.has_sensor else 0,
            rest_timeout=self.rest_duration + 2.0,
            return_speed=self.return_speed,
            longest_step=self.period,
        )


def load_body(path: str) -> RobotParameters:
    """Return the parameters in a file; for an empty path, the paper's values. Raises ConfigurationError."""
    if not path:
        return RobotParameters()
    return read_settings(Path(path), ParameterFileContent, ConfigurationError)
