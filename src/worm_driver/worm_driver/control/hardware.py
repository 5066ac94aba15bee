# SPDX-License-Identifier: Apache-2.0
"""Everything that a configured driver holds: the robot in its loop, the power sensor in its own. ROS is unknown."""

import contextlib
import math
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from worm_driver.control import diagnostics
from worm_driver.control.control_loop import ControlLoop, PowerLoop
from worm_driver.control.diagnostics import Report
from worm_driver.control.driver_settings import DriverSettings, PowerSettings
from worm_driver.control.robot import Robot
from worm_driver.control.telemetry import Snapshot
from worm_driver.errors import ConfigurationError, DriverError
from worm_driver.power import i2c
from worm_driver.power.ina219 import INA219, PowerSample, SampleStatus, calibration_for
from worm_driver.servos import serial_port
from worm_driver.servos.bus_types import BusCounters
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot.wire.virtual_clock import I2C, SERIAL, clock_of

#: per cycle, that an adapter may hold back: the state's and the health register's
_ANSWERS = 2
#: s, for which snapshots may pile up before the robot is held
_UNHEARD = 3.0
#: snapshots that may pile up before a virtual robot's time waits for whoever takes them, and for how long at most (s)
_BACKLOG = 250
_BACKLOG_PATIENCE = 10.0


@dataclass
class _Seen:
    """What the last report covered."""

    counters: BusCounters
    power: Counter[SampleStatus]


class Hardware:
    """Opens and checks everything, and starts the threads.

    Args:
        settings: of the robot.
        tracker_ready: whether the tracker sees the robot stand, or there is none to wait for.
        why_not_start: why neither torque nor a run may begin, in words; empty when they may.

    Attributes:
        snapshots: of the cycles, oldest first; whoever takes them out owns them. None is ever dropped.
        samples: of the power sensor, likewise.

    Raises:
        DriverError: a device is missing or not what the settings say; everything is closed again.
    """

    def __init__(
        self,
        settings: DriverSettings,
        tracker_ready: Callable[[], bool] = lambda: True,
        why_not_start: Callable[[], str] = lambda: "",
    ):
        self.settings = settings
        self._longest_stroke = settings.max_stroke  # that a run may have been begun with
        self.snapshots: deque[Snapshot] = deque()
        self.samples: deque[PowerSample] = deque()
        self._power_counts: Counter[SampleStatus] = Counter(dict.fromkeys(SampleStatus, 0))
        self._power: PowerLoop | None = None
        with contextlib.ExitStack() as opened:
            # First, as its lock keeps a second driver from the sensor, too, which has none and would be reset.
            self._bus = ServoBus.open(settings.port, settings.baud_rate)
            opened.callback(self._bus.close)
            # Before the clock: whoever takes part in a virtual robot's time may wait by that alone.
            sensor = _open_sensor(settings.power)
            if sensor is not None:
                opened.callback(sensor.device.close)
            self.clock = clock_of(settings.port, SERIAL)
            opened.callback(self.clock.close)
            self._bus.port.go_by(self.clock)
            self._check_latency(self._bus.port.latency)
            self.robot = Robot(
                settings,
                self._bus,
                self._valid_samples,
                tracker_ready,
                clock=self.clock,
                why_not_start=why_not_start,
            )
            opened.pop_all()
        self._seen = _Seen(self._bus.counters, Counter())
        self.loop = ControlLoop(self.robot, self._on_snapshot, self.clock)
        self.loop.start()
        if sensor is not None:
            clock = clock_of(settings.power.i2c_bus, I2C)
            self._power = PowerLoop(sensor, settings.period, self._on_sample, clock)
            self._power.start()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """In the order of a snapshot's servos."""
        return tuple(f"cable_{servo.number}" for servo in self.robot.actuators.cables) + tuple(
            f"fin_{servo.number}" for servo in self.robot.actuators.fins
        )

    @property
    def release_time(self) -> float:
        """s, which a release takes at most."""
        travel = self._longest_stroke + 0.02
        return math.pi / 2 * travel / self.settings.player.return_speed + 1.0

    def take(self, settings: DriverSettings) -> str:
        """Goes on with other limits; returns what follows for the run that is being played, in words."""
        self._longest_stroke = max(self._longest_stroke, settings.max_stroke)
        self.settings = settings
        return self.loop.ask(lambda now: self.robot.take(now, settings))

    def rest_line(self) -> str:
        """How long it may take to end; the launch file reads it, to be patient for as long."""
        return f"asked to end, it is at rest within {self.release_time:.1f} s"

    def description(self) -> list[str]:
        """What was found, one line each."""
        lines = [
            f"servo {servo.number}: {servo.model.name}, firmware {servo.firmware}"
            for servo in self.robot.actuators.servos
        ]
        limits = self.robot.limits
        lines.append(
            f"gaits to {limits.max_stroke:g} m, {limits.max_frequency:g} Hz, "
            f"{limits.max_cable_speed:.4f} m/s of cable"
        )
        latency = self._bus.port.latency
        if latency > 1e-3:
            lines.append(
                f"the latency timer of {self.settings.port} is {latency * 1e3:.0f} ms, not 1: install the udev rule"
            )
        if self.robot.actuators.left_on:
            lines.append(self.robot.actuators.left_on)
        lines.append(self.rest_line())
        if not self.robot.actuators.homed:
            lines.append("not homed: bring the robot to its initial length, then call home")
        return lines

    def close(self, reason: str, meanwhile: Callable[[], None] = lambda: None) -> list[str]:
        """Brings the robot to rest, releases it and closes everything; returns what failed, in words.

        ``meanwhile`` is called every few milliseconds until the robot is released.
        """
        self.loop.leave(reason)
        ended = self.loop.join(self.release_time, meanwhile)
        if self._power is not None:
            self._power.close()
        problems = list(self.loop.release_problems)
        if not ended:
            problems.append("the servo bus thread hangs: the servos stop by their bus watchdog")
        self._bus.close()
        return problems

    def report(self, latest: Snapshot) -> list[Report]:
        """On every part; to be called once a second."""
        robot, sensor = self.robot, self._seen
        counters, power = self._bus.counters, self._power_counts.copy()
        self._seen = _Seen(counters, power)
        timer = serial_port.latency_timer_ms(self.settings.port)
        reports = [
            diagnostics.gait_report(
                latest.player,
                active=latest.active,
                homed=robot.actuators.homed,
                left_on=robot.actuators.left_on,
            ),
            diagnostics.bus_report(self.settings.port, counters, sensor.counters, timer),
            diagnostics.timing_report(self.loop.report(), self.settings.period, self.loop.urgency),
        ]
        if robot.actuators.unreleased:
            reports.append(diagnostics.release_report(robot.actuators.unreleased))
        for servo, state in zip(robot.actuators.servos, latest.servos, strict=True):
            alert = servo.number in latest.alerts
            reports.append(diagnostics.servo_report(servo, state, alert=alert))
        if self._power is not None:
            where = (
                f"INA219 0x{self.settings.power.i2c_address:02X} on {self.settings.power.i2c_bus}"
            )
            reports.append(diagnostics.power_report(power - sensor.power, where))
        return reports

    def _check_latency(self, latency: float) -> None:
        """Raises ConfigurationError where answers may be held back for so long (s) that no cycle can be kept."""
        if _ANSWERS * latency >= self.settings.period:
            raise ConfigurationError(
                f"the latency timer of {self.settings.port} is {latency * 1e3:.0f} ms, too long for "
                f"{self.settings.rate:g} Hz: install the udev rule (99-worm.rules), or "
                f"echo 1 | sudo tee {serial_port.latency_timer_path(self.settings.port)}"
            )

    def _valid_samples(self) -> int:
        return 0 if self._power is None else self._power.valid_samples

    def _on_snapshot(self, snapshot: Snapshot) -> None:
        """In the loop's thread: hands a snapshot over; a robot that nobody listens to any more is held."""
        self.snapshots.append(snapshot)
        unheard = snapshot.command_time - self._oldest(snapshot).command_time
        if snapshot.active and unheard > _UNHEARD:
            reason = (
                f"the node has not listened for {unheard:.0f} s: the service stop would not work"
            )
            self.robot.fail(snapshot.command_time, reason)
        if self.clock.patience:
            self._wait_for_listener()

    def _wait_for_listener(self) -> None:
        """A virtual robot's time does not run away from whoever takes the snapshots."""
        end = time.monotonic() + _BACKLOG_PATIENCE
        while len(self.snapshots) > _BACKLOG and time.monotonic() < end:
            time.sleep(0.002)

    def _oldest(self, newest: Snapshot) -> Snapshot:
        """The one that waits for longest; the newest where another thread has just taken them all."""
        try:
            return self.snapshots[0]
        except IndexError:
            return newest

    def _on_sample(self, sample: PowerSample) -> None:
        self._power_counts[sample.status] += 1
        self.samples.append(sample)


def _open_sensor(settings: PowerSettings) -> INA219 | None:
    if not settings.i2c_bus:
        return None
    calibration = calibration_for(settings.shunt_resistance, settings.max_current)
    device = i2c.open_device(settings.i2c_bus, settings.i2c_address)
    sensor = INA219(device, settings.shunt_resistance, calibration)
    try:
        sensor.start()
    except DriverError:
        device.close()
        raise
    return sensor
