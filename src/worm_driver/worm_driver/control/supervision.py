# SPDX-License-Identifier: Apache-2.0
"""Pure functions that decide from the states of the servos, once per cycle, whether the robot may continue."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from worm_driver.servos.registers import WATCHDOG_EXPIRED, hardware_error_text
from worm_driver.servos.servo_setup import Servo
from worm_msgs.driver_file import DriverFile

#: Ratio of the limit that a servo enforces itself to the effort above which it is overloaded (`fault_level`). The ratio
#: is above 1, because a servo never exceeds its own limit: with a ratio of 1, no overload could be detected.
_HEADROOM = 1.1
#: Consecutive cycles with an overload or with too large a following error that are a fault.
_FAULTY_CYCLES = 5
#: Time for which a cable is contracted, although it is commanded to rest, that is a fault, s.
_UNRESTED = 1.0


def own_limit(servo: Servo, limits: DriverFile) -> float:
    """Return the largest effort that a cable servo itself permits, A; a load ratio if the servo measures no current."""
    if servo.model.measures_current:
        return min(_HEADROOM * limits.max_servo_current, servo.model.strongest_current)
    return min(_HEADROOM * limits.max_servo_load, 1.0)


def fault_level(servo: Servo, limits: DriverFile) -> float:
    """Return the effort above which a cable servo is overloaded, in the unit of `own_limit`.

    It is max_servo_current or max_servo_load, or less if the servo cannot exceed this limit by the factor _HEADROOM.
    """
    return own_limit(servo, limits) / _HEADROOM


class CableLength(NamedTuple):
    """Length changes of the cable of one servo, m: measured (NaN if unknown) and commanded."""

    measured: float
    commanded: float


@dataclass(frozen=True)
class Counts:
    """Durations of the present deviations.

    Attributes:
        silence: time without a state, s, by servo id.
        overload: consecutive cycles with overload, by servo id.
        following: consecutive cycles with too large a following error, by servo id.
        unrested: time for which a cable has been contracted, although it is commanded to rest, s, by servo id.
        cables: lengths in the present reading, by servo id.
    """

    silence: Mapping[int, float] = field(default_factory=dict)
    overload: Mapping[int, int] = field(default_factory=dict)
    following: Mapping[int, int] = field(default_factory=dict)
    unrested: Mapping[int, float] = field(default_factory=dict)
    cables: Mapping[int, CableLength] = field(default_factory=dict)


@dataclass(frozen=True)
class ServoHealth:
    """Registers that show whether a servo still has the settings that the driver wrote.

    Attributes:
        torque: torque_enable, raw.
        led: led, raw. The home mark of a cable servo.
        hardware_error: hardware_error_status, raw.
        watchdog: bus_watchdog, raw. 0: not armed; WATCHDOG_EXPIRED: expired.
    """

    torque: int
    led: int
    hardware_error: int
    watchdog: int


def silence(counts: Counts, silent: Iterable[int], watched: float) -> Counts:
    """Return the counts after a reading in which some servos returned no state.

    Args:
        counts: counts before the reading.
        silent: ids of the servos without a state.
        watched: time by which the silence of a servo without a state grows, s, see `watched_time`.
    """
    return replace(counts, silence={s: counts.silence.get(s, 0.0) + watched for s in silent})


def watched_time(elapsed: float, period: float) -> float:
    """Return the time (s) by which a silence grows with a reading that ended ``elapsed`` s after the previous one.

    Even if no servo answers, two readings of a punctual driver are at most two periods apart. Any further time is the
    driver's own lateness, in which it sent no request.
    """
    return min(elapsed, 2.0 * period)


def lateness(away: float, watchdog: float, load: float) -> str:
    """Return the message about a loop that was late for the servos' bus watchdog.

    Args:
        away: time between the starts of two consecutive cycles, s.
        watchdog: bus watchdog of the servos, s.
        load: load average of the computer.
    """
    return (
        f"the control loop began no cycle for {away * 1e3:.0f} ms, and the servos stop by their watchdog after "
        f"{watchdog * 1e3:.0f} ms: the computer was busy (load {load:.1f}) or the driver was suspended"
    )


def crowding(load: float, cores: int) -> str:
    """Return a possible cause of silence if the load average exceeds the number of cores, else an empty string.

    The kernel forwards the bytes of a serial line in a thread without real-time priority, even if the servo thread has
    real-time priority.
    """
    if load <= cores:
        return ""
    return f"; or this busy computer delays its answers (load {load:.1f} on {cores} cores)"


def overload(counts: Counts, efforts: Mapping[int, float], levels: Mapping[int, float]) -> Counts:
    """Return the counts after a reading of the efforts of the cable servos that answered.

    Args:
        counts: counts before the reading.
        efforts: effort by servo id, A; a load ratio for a servo that measures no current.
        levels: effort by servo id above which a servo is overloaded, in the same unit.
    """
    now = dict(counts.overload)
    for servo, effort in efforts.items():
        now[servo] = now.get(servo, 0) + 1 if abs(effort) > levels[servo] else 0
    return replace(counts, overload=now)


def following(counts: Counts, cables: Mapping[int, CableLength], limits: DriverFile) -> Counts:
    """Return the counts after a reading of the cables by servo id. An unknown length counts as no error."""
    off = (
        s
        for s, at in cables.items()
        if abs(at.measured - at.commanded) > limits.max_following_error
    )
    return replace(
        counts, following={s: counts.following.get(s, 0) + 1 for s in off}, cables=cables
    )


def resting(counts: Counts, contracted: Iterable[int], period: float) -> Counts:
    """Return the counts after a cycle (of a period in s) in which some servos, by id, are contracted at rest."""
    return replace(counts, unrested={s: counts.unrested.get(s, 0.0) + period for s in contracted})


def fault_in_counts(
    counts: Counts, limits: DriverFile, problems: Mapping[int, str], otherwise: str = ""
) -> str | None:
    """Return the fault that the counts amount to, as a message, or None.

    Args:
        counts: counts after the present reading.
        limits: parameters of the driver with the limits of the deviations.
        problems: why the state of a servo is missing, by id.
        otherwise: further possible cause of a silence, see `crowding`. It is appended to the message about a silence.
    """
    for servo, duration in counts.silence.items():
        if duration >= limits.max_silence:
            why = problems.get(servo, "does not answer")
            return f"servo {servo} has returned no state for {duration * 1e3:.0f} ms: it {why}{otherwise}"
    for servo, cycles in counts.overload.items():
        if cycles >= _FAULTY_CYCLES:
            return (
                f"servo {servo} is beyond its limit (limits.max_servo_current_a, limits.max_servo_load): the "
                "cable is blocked or overloaded"
            )
    for servo, cycles in counts.following.items():
        if cycles >= _FAULTY_CYCLES:
            when = f"beyond limits.max_following_error_m ({limits.max_following_error * 1e3:g} mm)"
            why = ", or the limit is too small for a loaded servo at this rate_hz"
            return _off_command(servo, counts.cables[servo], when, why)
    for servo, duration in counts.unrested.items():
        if duration >= _UNRESTED:
            return _off_command(servo, counts.cables[servo], "although it should be at rest")
    return None


def _off_command(servo: int, cable: CableLength, when: str, otherwise: str = "") -> str:
    measured, commanded = cable.measured * 1e3, cable.commanded * 1e3
    return (
        f"the cable of servo {servo} is {abs(measured - commanded):.1f} mm off its command (at {measured:.1f} mm "
        f"instead of {commanded:.1f} mm), {when}: it is blocked, its servo is too slow or too weak, or its position is "
        f"wrong{otherwise}"
    )


def fault_in_health(servo: int, health: ServoHealth, *, is_cable: bool) -> str | None:
    """Return the fault that a servo's health registers show while its torque should be on, as a message, or None."""
    if health.hardware_error:
        return f"servo {servo} reports {hardware_error_text(health.hardware_error)}"
    if health.watchdog == WATCHDOG_EXPIRED:
        return f"the bus watchdog of servo {servo} has expired: the command stream was interrupted"
    if health.torque and health.watchdog and (health.led or not is_cable):
        return None
    armed = "on" if health.watchdog else "on, without its bus watchdog"
    torque = f"its torque is {armed if health.torque else 'off'}"
    if is_cable and not health.led:
        return f"servo {servo} has restarted: {torque}, and its turn count is lost"
    if not (is_cable or health.torque or health.watchdog):
        return f"servo {servo} has restarted: {torque}"
    return f"servo {servo} was changed by another program, as it has not restarted: {torque}"


def position_jumped(servo: int, jump: int) -> str:
    """Return the message about a servo whose position jumped by some ticks from the last plausible one."""
    return (
        f"the position of servo {servo} jumped by {jump} ticks, in the second of two implausible readings: the servo "
        "cannot have turned so far, so its turn count or its encoder is wrong"
    )
