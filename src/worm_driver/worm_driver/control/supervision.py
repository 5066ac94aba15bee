# SPDX-License-Identifier: Apache-2.0
"""Decides from what the servos report whether the robot may go on: pure, one look per cycle."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from worm_driver.servos.registers import TICKS_PER_TURN, WATCHDOG_EXPIRED, hardware_error_text


@dataclass(frozen=True)
class Limits:
    """When a deviation becomes a fault.

    Attributes:
        max_silence: s for which a servo was asked and gave no state; the driver's own lateness does not count.
        max_current: A, of a cable servo.
        max_load: of a cable servo that measures no current, ratio of its strongest.
        overload_cycles: cycles in a row above one of the two.
        following_error: m, of the cable behind its command.
        following_cycles: cycles in a row beyond it.
    """

    max_silence: float = 0.035
    max_current: float = 2.0
    max_load: float = 0.9
    overload_cycles: int = 5
    following_error: float = 0.015
    following_cycles: int = 5


@dataclass(frozen=True)
class Counts:
    """What has been going on for how many cycles in a row, by servo; and how long servos have been silent (s)."""

    silence: Mapping[int, float] = field(default_factory=dict)
    overload: Mapping[int, int] = field(default_factory=dict)
    following: int = 0


@dataclass(frozen=True)
class Health:
    """The registers that say whether a servo is still what it was set up to be."""

    torque: int
    led: int
    hardware_error: int
    watchdog: int


def silence(counts: Counts, silent: Iterable[int], watched: float) -> Counts:
    """Counts after a look at which some servos gave no state, and which stands for a time (s), see watched_time."""
    return replace(counts, silence={s: counts.silence.get(s, 0.0) + watched for s in silent})


def watched_time(elapsed: float, period: float) -> float:
    """For how long (s) a look at the servos stands, which ended ``elapsed`` s after the one before.

    A driver that is not late asks twice within two periods when nobody answers. What went by beyond that is its own
    lateness, in which no servo was asked.
    """
    return min(elapsed, 2.0 * period)


def lateness(away: float, watchdog: float, load: float) -> str:
    """What to say of a loop that left the servos alone for a time (s) beyond their watchdog (s), at a load average."""
    return (
        f"the control loop was late by {away * 1e3:.0f} ms, and the servos stop by their watchdog after "
        f"{watchdog * 1e3:.0f} ms: the computer was busy (load {load:.1f}) or the driver was suspended"
    )


def crowding(load: float, cores: int) -> str:
    """What else explains a silence while the load average exceeds the computer's cores; else nothing.

    The kernel passes the bytes of a serial line on in a thread that has no real-time priority, whatever ours has.
    """
    if load <= cores:
        return ""
    return f"; or its answers are held up in this computer, which is busy (load {load:.1f} on {cores} cores)"


def overload(counts: Counts, efforts: Mapping[int, float], levels: Mapping[int, float]) -> Counts:
    """Counts after a look at the efforts of the cable servos that answered; levels: above which it is too much.

    Both by id, in A or as a ratio of the load, as the servo measures.
    """
    now = dict(counts.overload)
    for servo, effort in efforts.items():
        now[servo] = now.get(servo, 0) + 1 if abs(effort) > levels[servo] else 0
    return replace(counts, overload=now)


def following(counts: Counts, error: float, limits: Limits) -> Counts:
    """Counts after a look at the following error (m); NaN is no error."""
    return replace(
        counts, following=counts.following + 1 if abs(error) > limits.following_error else 0
    )


def fault_in_counts(
    counts: Counts, limits: Limits, problems: Mapping[int, str], otherwise: str = ""
) -> str | None:
    """The fault that the counts amount to, in words.

    problems: why a servo gives no state, by id. otherwise: what else explains it, see crowding.
    """
    for servo, duration in counts.silence.items():
        if duration >= limits.max_silence:
            why = problems.get(servo, "does not answer")
            return f"servo {servo} gives no state for {duration * 1e3:.0f} ms: it {why}{otherwise}"
    for servo, cycles in counts.overload.items():
        if cycles >= limits.overload_cycles:
            return (
                f"servo {servo} is beyond its limit (limits.max_servo_current_A, limits.max_servo_load): the "
                "cable is blocked or overloaded"
            )
    if counts.following >= limits.following_cycles:
        return f"the cable is more than {limits.following_error * 1e3:g} mm off its command: it is blocked"
    return None


def fault_in_health(servo: int, health: Health, *, is_cable: bool) -> str | None:
    """The fault that a servo's health registers show while its torque should be on, in words."""
    if health.hardware_error:
        return f"servo {servo} reports {hardware_error_text(health.hardware_error)}"
    if health.watchdog == WATCHDOG_EXPIRED:
        return f"the bus watchdog of servo {servo} has expired: the command stream was interrupted"
    if not health.torque or not health.watchdog or (is_cable and not health.led):
        armed = "on" if health.watchdog else "on, without its bus watchdog"
        torque = armed if health.torque else "off"
        return f"servo {servo} has restarted: its torque is {torque}" + (
            ", and its turn count is lost" if is_cable else ""
        )
    return None


def turn_count_jumped(before: int, after: int, elapsed: float, fastest: float) -> bool:
    """Whether a position (ticks) has changed in a time (s) by more than a servo of a speed (rad/s) can turn.

    Then its turn count was folded.
    """
    possible = 2.0 * fastest * elapsed / math.tau * TICKS_PER_TURN + TICKS_PER_TURN / 8
    return abs(after - before) > possible
