# SPDX-License-Identifier: Apache-2.0
"""Validated driver configuration."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from worm_driver.control.supervision import Limits
from worm_driver.errors import ConfigurationError
from worm_driver.gait.gait_player import PlayerSettings
from worm_driver.servos.registers import COMMON
from worm_driver.servos.transmission import Fin, Spool
from worm_msgs.driver_file import DriverFile
from worm_msgs.robot_parameters import ParameterFileContent, RobotParameters
from worm_msgs.settings_file import read_settings


@dataclass(frozen=True)
class PowerSettings:
    """I2C bus, address, shunt and range of the INA219, in SI units. An empty bus means that there is no sensor."""

    i2c_bus: str = DriverFile.i2c_bus
    i2c_address: int = DriverFile.i2c_address
    shunt_resistance: float = DriverFile.shunt_resistance
    max_current: float = DriverFile.max_current


@dataclass(frozen=True)
class DriverSettings:
    """Settings of one robot, in SI units.

    Attributes:
        port: path of the serial port of the servos.
        spools: spools of the cable servos, at least one.
        fins: fin servos.
        baud_rate: baud rate of the servos, bit/s.
        watchdog: time without packets after which the servos stop by themselves, s; a multiple of the register's step.
        home_at_start: True if the robot stands at its initial length when the driver is configured. The driver then
            homes it, unless it is homed already.
        rate: rate of commands and telemetry, Hz.
        real_time_priority: SCHED_FIFO priority of the servo thread; the other threads have half of it. 0: normal
            scheduling.
        max_stroke: largest sum of stroke and pretension of a gait, m.
        max_frequency: largest frequency of a gait, Hz.
        max_cable_speed: largest speed of the cable, m/s.
        fin_speed: largest speed of the fin servos, rad/s.
        power: settings of the power sensor.
        player: times and speeds of the gait player.
        limits: limits beyond which a deviation becomes a fault.
        body: parameters of the robot and its pipe.
    """

    port: str
    spools: tuple[Spool, ...]
    fins: tuple[Fin, ...] = ()
    baud_rate: int = DriverFile.baud_rate
    watchdog: float = DriverFile.watchdog
    home_at_start: bool = DriverFile.home_at_start
    rate: float = DriverFile.rate
    real_time_priority: int = 0
    max_stroke: float = DriverFile.max_stroke
    max_frequency: float = DriverFile.max_frequency
    max_cable_speed: float = DriverFile.max_cable_speed
    fin_speed: float = DriverFile.fin_speed
    power: PowerSettings = field(default_factory=PowerSettings)
    player: PlayerSettings = field(default_factory=PlayerSettings)
    limits: Limits = field(default_factory=Limits)
    body: RobotParameters = field(default_factory=RobotParameters)

    def __post_init__(self) -> None:
        if not self.spools:
            raise ConfigurationError("there is no cable servo: set cable_servos.ids")
        ids = [s.servo for s in self.spools] + [f.servo for f in self.fins]
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

    @property
    def period(self) -> float:
        """Period of the control cycle, s."""
        return 1.0 / self.rate


def load_body(path: str) -> RobotParameters:
    """Return the parameters in a file; for an empty path, the paper's values. Raises ConfigurationError."""
    if not path:
        return RobotParameters()
    return read_settings(Path(path), ParameterFileContent, ConfigurationError)
