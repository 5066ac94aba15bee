# SPDX-License-Identifier: Apache-2.0
"""Diagnostic reports (REP 107), which the driver publishes once a second. Free of ROS."""

import enum
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from worm_driver.control.real_time import Scheduling
from worm_driver.control.timing import TimingReport
from worm_driver.gait.gait_player import Phase, PlayerState
from worm_driver.power.ina219 import SampleStatus
from worm_driver.servos.servo_bus import BusCounters
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.state_reader import SILENT, ServoState

#: A report warns if the temperature is closer than this to the servo's own limit, degC.
_WARM = 10.0
#: 99th percentile of the period error above which a report warns, s.
_LATE = 0.002


class Level(enum.Enum):
    """Severity of a report."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class DiagnosticReport:
    """Diagnostic report on one part of the driver.

    Attributes:
        name: name of the part.
        level: severity.
        message: state of the part or its problem, in one line.
        hardware_id: description of the device; empty without one.
        values: pairs of key and value. The last part of the key is the unit, if the value has one.
    """

    name: str
    level: Level
    message: str
    hardware_id: str = ""
    values: tuple[tuple[str, str], ...] = ()


def servo_report(
    servo: Servo, state: ServoState, *, alert: bool, problem: str = "does not answer"
) -> DiagnosticReport:
    """Return the report on one servo.

    Args:
        servo: the servo.
        state: its latest state, SILENT if it is missing.
        alert: True if the servo reports a hardware error.
        problem: why the state is missing.
    """
    low, high = servo.voltage_range
    if state is SILENT:
        level, message = Level.ERROR, problem
    elif alert:
        level, message = Level.ERROR, "reports a hardware error"
    elif not low <= state.voltage <= high:
        level = Level.WARN
        message = f"the supply is {state.voltage:.1f} V, outside {low:.1f} to {high:.1f} V"
    elif hot := heat(servo, state.temperature):
        level, message = Level.WARN, hot
    else:
        level, message = Level.OK, "ok"
    return DiagnosticReport(
        f"driver: servo {servo.number}",
        level,
        message,
        f"{servo.model.name} id {servo.number} firmware {servo.firmware}",
        (
            ("position_rad", f"{state.position:.4f}"),
            ("current_a" if servo.model.measures_current else "load_ratio", f"{state.effort:.4f}"),
            ("voltage_v", f"{state.voltage:.1f}"),
            ("temperature_deg_c", f"{state.temperature:.0f}"),
        ),
    )


def heat(servo: Servo, temperature: float) -> str:
    """Return a message if the temperature of a servo (degC) is near its limit, else an empty string."""
    if temperature <= servo.temperature_limit - _WARM:
        return ""
    return f"{temperature:.0f} degC; the servo shuts down at {servo.temperature_limit:.0f} degC"


def bus_report(
    port: str, now: BusCounters, before: BusCounters, latency_timer: int | None
) -> DiagnosticReport:
    """Return the report on the servo bus, with the failures since the previous report.

    Args:
        port: path of the serial port.
        now: present counters.
        before: counters at the previous report.
        latency_timer: latency timer of the adapter, ms; None if it has none.
    """
    new = {name: count - getattr(before, name) for name, count in asdict(now).items()}
    failures = {name: count for name, count in new.items() if count and name != "exchanges"}
    if latency_timer is not None and latency_timer > 1:
        level = Level.WARN
        message = f"latency timer is {latency_timer} ms: install the udev rule, or write 1 to it"
    elif failures:
        level = Level.WARN
        message = (
            ", ".join(f"{count} {name}" for name, count in failures.items()) + " in the last second"
        )
    else:
        level, message = Level.OK, "ok"
    values = tuple((name, str(count)) for name, count in asdict(now).items())
    return DiagnosticReport("driver: servo bus", level, message, port, values)


def timing_report(timing: TimingReport, period: float, scheduling: Scheduling) -> DiagnosticReport:
    """Return the report on the timing of the control loop and on the scheduling of its thread. The period is in s."""
    if math.isnan(timing.p99_error):
        level, message = Level.OK, "starting"
    elif timing.p99_error > _LATE:
        level = Level.WARN
        cause = _cause_of_lateness(timing, period, scheduling)
        message = f"p99 of the period error is {timing.p99_error * 1e3:.2f} ms: {cause}"
    else:
        level, message = Level.OK, "ok"
    return DiagnosticReport(
        "driver: timing",
        level,
        message,
        "",
        (
            ("period_s", f"{period:.6f}"),
            ("mean_period_s", f"{timing.mean_period:.6f}"),
            ("p99_period_error_s", f"{timing.p99_error:.6f}"),
            ("max_period_error_s", f"{timing.max_error:.6f}"),
            ("p99_wake_s", f"{timing.p99_wake:.6f}"),
            ("p99_cycle_s", f"{timing.p99_cycle:.6f}"),
            ("missed_deadlines", str(timing.missed)),
            ("cycles", str(timing.cycles)),
            ("real_time_priority", scheduling.description),
        ),
    )


def _cause_of_lateness(timing: TimingReport, period: float, scheduling: Scheduling) -> str:
    """Return the cause of late cycles (late wake-ups or long cycles), and what to do about it."""
    if timing.p99_cycle < period:
        remedy = (
            "free the machine"
            if scheduling.granted
            else f"free the machine; {scheduling.description}"
        )
        return f"the computer wakes the thread {timing.p99_wake * 1e3:.2f} ms late (p99): {remedy}"
    return (
        f"a cycle takes {timing.p99_cycle * 1e3:.1f} ms (p99) of {period * 1e3:g}: the servos answer late, or their "
        "bytes reach this process late on a busy machine (see the counters of the servo bus)"
    )


def power_report(
    counts: dict[SampleStatus, int], where: str, reversed_current: str
) -> DiagnosticReport:
    """Return the report on the power sensor.

    Args:
        counts: number of samples in the last second, by status.
        where: chip, address and bus of the sensor.
        reversed_current: see `ina219.reversed_current`.
    """
    total = sum(counts.values())
    bad = {
        status: count
        for status, count in counts.items()
        if status in (SampleStatus.OVERFLOW, SampleStatus.BUS_ERROR, SampleStatus.SENSOR_RESET)
        and count
    }
    if total == 0:
        level, message = Level.ERROR, "no samples in the last second"
    elif bad:
        worst = SampleStatus.BUS_ERROR in bad and bad[SampleStatus.BUS_ERROR] == total
        level = Level.ERROR if worst else Level.WARN
        message = (
            ", ".join(f"{count} x {status.value}" for status, count in bad.items())
            + " in the last second"
        )
    elif counts.get(SampleStatus.VALID, 0) < counts.get(SampleStatus.NOT_READY, 0):
        level = Level.WARN
        message = "the sensor makes few new conversions, or returns identical bits: check its supply and bus"
    elif reversed_current:
        level, message = Level.WARN, reversed_current
    else:
        level, message = Level.OK, "ok"
    values = tuple((status.name.lower(), str(counts.get(status, 0))) for status in SampleStatus)
    return DiagnosticReport("driver: power sensor", level, message, where, values)


def release_report(problems: Sequence[str]) -> DiagnosticReport:
    """Return the report on a failed release of the torque. ``problems`` are its failures, one sentence each."""
    message = f"the torque may still be on: {'; '.join(problems)}: switch the supply off before you touch the robot"
    return DiagnosticReport("driver: release", Level.ERROR, message)


def gait_report(
    player: PlayerState, *, active: bool, homed: bool, left_on: str = ""
) -> DiagnosticReport:
    """Return the report on the gait player.

    Args:
        player: state of the gait player.
        active: True if the torque is on.
        homed: True if the length of the cable is known.
        left_on: message about a torque that was left on, see `Actuators.left_on`.
    """
    if left_on and not active:
        level, message = Level.WARN, left_on
    elif active and player.phase is Phase.FAULT:
        level, message = Level.ERROR, player.message
    elif not homed:
        level = Level.WARN
        message = "not homed: bring the robot to its initial length, then call the service home"
    else:
        level, message = Level.OK, player.phase.value if active else "torque is off"
    return DiagnosticReport(
        "driver: gait",
        level,
        message,
        "",
        (("homed", str(homed)), ("length_change_m", f"{player.length_change:.5f}")),
    )


def network_report(text: str, *, is_local: bool) -> DiagnosticReport:
    """Return the report on who can reach the driver: only this computer, or the network. ``text`` is its message."""
    return DiagnosticReport("driver: network", Level.OK if is_local else Level.WARN, text)


def offline_report(failure: Exception | None) -> DiagnosticReport:
    """Return the report of a driver without open devices. ``failure`` is the error of a failed transition, or None."""
    level = Level.OK if failure is None else Level.ERROR
    return DiagnosticReport(
        "driver: gait", level, "not configured" if failure is None else str(failure)
    )
