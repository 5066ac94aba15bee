# SPDX-License-Identifier: Apache-2.0
"""Resources of a configured driver: the robot and the power sensor, each with its own thread. Free of ROS."""

import contextlib
import math
import time
from collections import Counter, deque
from collections.abc import Callable

from worm_driver.control import diagnostics
from worm_driver.control.control_loop import ControlLoop, PowerLoop
from worm_driver.control.diagnostics import DiagnosticReport
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.robot import CycleSnapshot, Robot
from worm_driver.power import i2c
from worm_driver.power.ina219 import (
    INA219,
    PowerSample,
    SampleStatus,
    calibration_for,
    reversed_current,
)
from worm_driver.servos import serial_port
from worm_driver.servos.registers import ServoModel
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.simulated_clock import I2C, SERIAL, clock_of

#: Factor by which late cycles may prolong a return to rest, which does not catch up.
_LATENESS = 2.0
#: Number of valid power samples after configure whose mean must not be negative.
_FIRST_SAMPLES = 10
#: Age of the oldest unread snapshot beyond which the robot enters FAULT, s.
_LISTENING_TIMEOUT = 3.0
#: Number of unread snapshots beyond which a virtual robot's time waits for their reader.
_BACKLOG = 250
#: Longest time for which the time of a virtual robot waits for the reader, s.
_BACKLOG_TIMEOUT = 10.0


class Hardware:
    """Open devices of a robot and the threads that use them.

    Args:
        settings: settings of the driver.
        tracker_ready: returns True if the tracker sees the robot at rest, or if there is no tracker.
        why_not_start: returns why neither torque nor a run may begin; empty if they may.

    Attributes:
        settings: settings at the start, which the robot's own ones may undercut later (`Robot.apply_settings`).
        clock: clock of the robot.
        robot: the robot, owned by the loop.
        loop: control loop.
        snapshots: queue of the snapshots of all cycles, oldest first. The reader removes them; none is ever dropped.
        samples: queue of the power sensor's samples, oldest first. The reader removes them; none is ever dropped.

    Raises:
        DriverError: A device is missing or does not match the settings. The open devices are closed again.
    """

    def __init__(
        self,
        settings: DriverSettings,
        tracker_ready: Callable[[], bool] = lambda: True,
        why_not_start: Callable[[], str] = lambda: "",
    ):
        self.settings = settings
        self.snapshots: deque[CycleSnapshot] = deque()
        self.samples: deque[PowerSample] = deque()
        self._first_samples: list[PowerSample] = []
        self._reversed_current = ""
        self._power_counts: Counter[SampleStatus] = Counter(dict.fromkeys(SampleStatus, 0))
        self._power: PowerLoop | None = None
        with contextlib.ExitStack() as opened:
            # The bus is opened first: its lock keeps a second driver from resetting the sensor, which has no lock.
            self._bus = ServoBus.open(settings.port, settings.baud_rate)
            opened.callback(self._bus.close)
            # The sensor is opened before the clock: a thread with a virtual robot's clock may wait on this clock only.
            sensor = None
            if settings.has_sensor:
                calibration = calibration_for(settings.shunt_resistance, settings.max_current)
                device = i2c.open_device(settings.i2c_bus, settings.i2c_address)
                opened.callback(device.close)
                sensor = INA219(device, settings.shunt_resistance, calibration)
                sensor.start()
            self.clock = clock_of(settings.port, SERIAL)
            opened.callback(self.clock.close)
            self._bus.port.go_by(self.clock)
            serial_port.require_latency(settings.port, self._bus.port.latency, settings.period)
            self.robot = Robot(
                settings,
                self._bus,
                self._valid_samples,
                tracker_ready,
                clock=self.clock,
                why_not_start=why_not_start,
            )
            opened.pop_all()
        # Counters of the bus and of the power samples at the previous report.
        self._reported = self._bus.counters, Counter[SampleStatus]()
        self.loop = ControlLoop(self.robot, self._on_snapshot, self.clock)
        self.loop.start()
        if sensor is not None:
            clock = clock_of(settings.i2c_bus, I2C)
            self._power = PowerLoop(sensor, settings.period, self._on_sample, clock)
            self._power.start()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in the order of a snapshot's servos."""
        return tuple(f"cable_{servo.number}" for servo in self.robot.actuators.cables) + tuple(
            f"fin_{servo.number}" for servo in self.robot.actuators.fins
        )

    @property
    def joint_models(self) -> tuple[ServoModel, ...]:
        """Models of the servos, in the order of a snapshot's servos."""
        return tuple(servo.model for servo in self.robot.actuators.servos)

    @property
    def release_time(self) -> float:
        """Longest duration of a return to rest and of the release after it, s."""
        # The limit at the start, because a run may have begun before it was lowered.
        travel = self.settings.max_stroke + 0.02
        return _LATENESS * math.pi / 2 * travel / self.robot.return_speed + 1.0

    def description(self) -> list[str]:
        """Return the sentences that describe the devices found."""
        lines = [
            f"servo {servo.number}: {servo.model.name}, firmware {servo.firmware}"
            for servo in self.robot.actuators.servos
        ]
        limits = self.robot.limits
        lines.append(
            f"limits of gaits: stroke {limits.max_stroke:g} m, frequency {limits.max_frequency:g} Hz, "
            f"cable speed {limits.max_cable_speed:.4f} m/s"
        )
        if self.robot.actuators.left_on:
            lines.append(self.robot.actuators.left_on)
        lines.append(f"a return to rest takes at most {self.release_time:.1f} s")
        if not self.robot.actuators.homed:
            lines.append("not homed: bring the robot to its initial length, then call home")
        return lines

    def close(self, reason: str, meanwhile: Callable[[], None] = lambda: None) -> list[str]:
        """Bring the robot to rest, release it unless it would spring back, and close all devices.

        Args:
            reason: reason for the end, shown to the operator.
            meanwhile: called every few milliseconds until the robot is released.

        Returns:
            Failures, one sentence each.
        """
        self.loop.shutdown(reason)
        ended = self.loop.join(self.release_time, meanwhile)
        if self._power is not None:
            self._power.close()
        problems = list(self.loop.release_problems)
        if not ended:
            problems.append("the servo bus thread hangs: the servos stop by their bus watchdog")
        self._bus.close()
        return problems

    def report(self, latest: CycleSnapshot) -> list[DiagnosticReport]:
        """Return the diagnostic reports on all parts. Call this method once a second.

        Args:
            latest: snapshot of the latest cycle.
        """
        robot, (counters_before, power_before) = self.robot, self._reported
        counters, power = self._reported = self._bus.counters, self._power_counts.copy()
        timer = serial_port.latency_timer_ms(self.settings.port)
        reports = [
            diagnostics.gait_report(
                latest.player,
                active=latest.active,
                homed=robot.actuators.homed,
                left_on=robot.actuators.left_on,
            ),
            diagnostics.bus_report(self.settings.port, counters, counters_before, timer),
            diagnostics.timing_report(
                self.loop.report(), self.settings.period, self.loop.scheduling
            ),
        ]
        if robot.actuators.unreleased:
            reports.append(diagnostics.release_report(robot.actuators.unreleased))
        for servo, state in zip(robot.actuators.servos, latest.servos, strict=True):
            alert = servo.number in latest.alerts
            problem = robot.problems.get(servo.number, "does not answer")
            reports.append(diagnostics.servo_report(servo, state, alert=alert, problem=problem))
        if self._power is not None:
            where = f"INA219 0x{self.settings.i2c_address:02X} on {self.settings.i2c_bus}"
            reports.append(
                diagnostics.power_report(power - power_before, where, self._reversed_current)
            )
        return reports

    def _valid_samples(self) -> int:
        return 0 if self._power is None else self._power.valid_samples

    def _on_snapshot(self, snapshot: CycleSnapshot) -> None:
        """Queue a snapshot, in the loop's thread. Put the robot into FAULT if the node no longer reads the queue."""
        self.snapshots.append(snapshot)
        unread = snapshot.command_time - self._oldest(snapshot).command_time
        if snapshot.active and unread > _LISTENING_TIMEOUT:
            reason = f"the driver's ROS thread has not read the robot's state for {unread:.0f} s"
            self.robot.fail(snapshot.command_time, reason)
        if self.clock.least_timeout:
            self._wait_for_listener()

    def _wait_for_listener(self) -> None:
        """Wait for the reader of the snapshots, so that a virtual robot's time does not run ahead of it."""
        end = time.monotonic() + _BACKLOG_TIMEOUT
        while len(self.snapshots) > _BACKLOG and time.monotonic() < end:
            time.sleep(0.002)

    def _oldest(self, newest: CycleSnapshot) -> CycleSnapshot:
        """Return the oldest unread snapshot, or the newest if another thread has just emptied the queue."""
        try:
            return self.snapshots[0]
        except IndexError:
            return newest

    def _on_sample(self, sample: PowerSample) -> None:
        self._power_counts[sample.status] += 1
        self.samples.append(sample)
        if sample.status is SampleStatus.VALID and len(self._first_samples) < _FIRST_SAMPLES:
            self._first_samples.append(sample)
            if len(self._first_samples) == _FIRST_SAMPLES:
                self._reversed_current = reversed_current(self._first_samples)
