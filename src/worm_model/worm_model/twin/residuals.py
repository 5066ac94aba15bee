# SPDX-License-Identifier: Apache-2.0
"""Residuals and the health that they speak of.

Each channel (position, length, power) keeps the mean square of its residual in units of its usual size,
forgotten over ``MEMORY_S`` of the samples' own time. The root of it decides: healthy up to ``SUSPECT_FROM``,
faulty beyond ``FAULTY_FROM``. A channel without samples for ``SILENT_S`` has no say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from worm_model.twin.records import NANOSECONDS, Health, ResidualRecord
from worm_model.twin.twin_settings import TwinSettings

MEMORY_S = 2.0
SILENT_S = 5.0
SUSPECT_FROM = 2.0
FAULTY_FROM = 4.0

POSITION, LENGTH, POWER = "position", "length", "power"
COMPLAINTS = {
    POSITION: "the robot is not where the twin expects it",
    LENGTH: "the body does not follow the command as the actuation model expects",
    POWER: "the power is not what the motion should cost",
}


@dataclass(frozen=True)
class Channel:
    """Mean square of a residual over its usual size, with the stamp of its newest sample."""

    stamp_ns: int
    mean_square: float


@dataclass(frozen=True)
class Monitor:
    """The channels, the energy measured so far, and what has been reported of the present cycle's anchors.

    ``energy`` in J since the run's start at ``power_ns``, when ``power`` W was measured; ``warning`` is
    shown until ``warning_until_ns``.
    """

    channels: dict[str, Channel] = field(default_factory=dict)
    power_ns: int = 0
    power: float = math.nan
    energy: float = math.nan
    warning: str = ""
    warning_until_ns: int = 0


def start_monitor(monitor: Monitor, onset_ns: int) -> Monitor:
    """The monitor at the start of a run: the energy counts from there."""
    return replace(
        monitor, power_ns=onset_ns, power=math.nan, energy=0.0, warning="", warning_until_ns=0
    )


def count_energy(monitor: Monitor, stamp_ns: int, power: float) -> Monitor:
    """Adds the measured energy up to a power sample (W), by trapezoids; the first counts from the start on."""
    if stamp_ns <= monitor.power_ns:
        return monitor
    before = power if math.isnan(monitor.power) else monitor.power
    step = 0.5 * (before + power) * (stamp_ns - monitor.power_ns) / NANOSECONDS
    return replace(monitor, power_ns=stamp_ns, power=power, energy=monitor.energy + step)


def observe(monitor: Monitor, name: str, stamp_ns: int, residual: float, scale: float) -> Monitor:
    """The monitor with a residual of a channel."""
    square = (residual / scale) ** 2
    before = monitor.channels.get(name)
    if before is not None:
        elapsed = max(stamp_ns - before.stamp_ns, 0) / NANOSECONDS
        share = math.exp(-elapsed / MEMORY_S)
        square = share * before.mean_square + (1.0 - share) * square
        stamp_ns = max(stamp_ns, before.stamp_ns)
    else:
        square = min(square, 1.0)  # one sample is no history
    return replace(monitor, channels={**monitor.channels, name: Channel(stamp_ns, square)})


def forget(monitor: Monitor, name: str) -> Monitor:
    """The monitor without what a channel has said, once that is explained."""
    kept = {key: channel for key, channel in monitor.channels.items() if key != name}
    return replace(monitor, channels=kept)


def health(monitor: Monitor, stamp_ns: int) -> tuple[Health, str]:
    """(health, what is wrong) at a stamp."""
    sizes = {
        name: math.sqrt(channel.mean_square)
        for name, channel in monitor.channels.items()
        if stamp_ns - channel.stamp_ns <= SILENT_S * NANOSECONDS
    }
    warned = monitor.warning and stamp_ns <= monitor.warning_until_ns
    return judge(sizes, monitor.warning if warned else "")


def judge(sizes: Mapping[str, float], warning: str) -> tuple[Health, str]:
    """(health, what is wrong) from the channels' residuals in units of their usual size, and a warning or nothing."""
    found = [warning] if warning else []
    found += [
        f"{COMPLAINTS[name]} ({sizes[name]:.1f} times the usual residual)"
        for name in COMPLAINTS
        if sizes.get(name, 0.0) > SUSPECT_FROM
    ]
    if any(size > FAULTY_FROM for size in sizes.values()):
        return Health.FAULTY, "; ".join(found)
    if found:
        return Health.SUSPECT, "; ".join(found)
    return (Health.HEALTHY, "") if sizes else (Health.UNKNOWN, "")


def record(
    monitor: Monitor,
    settings: TwinSettings,
    stamp_ns: int,
    position: float = math.nan,
    length: float = math.nan,
    power: float = math.nan,
    energy: float = math.nan,
) -> ResidualRecord:
    """The residuals of a sample with the health at that time."""
    level, message = health(monitor, stamp_ns)
    return ResidualRecord(
        stamp_ns=stamp_ns,
        rear_position=position,
        rear_position_scale=settings.position_scale_m,
        length=length,
        length_scale=settings.length_scale_m,
        power=power,
        power_scale=settings.power_scale_W,
        energy=energy,
        health=level,
        message=message,
    )
