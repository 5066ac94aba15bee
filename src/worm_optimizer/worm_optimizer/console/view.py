# SPDX-License-Identifier: Apache-2.0
"""Content of the pages about the robot: present values, state, and possible actions."""

from __future__ import annotations

import math
from collections.abc import Mapping

from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import STALE_S, Health, StateRecord
from worm_model.twin.run_margins import spare_of
from worm_optimizer.robot_commands import Snapshot

SOURCES: Mapping[str, str] = {  # topic and the name of its source
    "body_length/commanded": "driver",
    "body_length/cable": "cable",
    "power": "power",
    "tracker": "tracker",
    "twin/state": "twin",
}
HISTORY_S = 60.0
SAMPLE_S = 0.2  # period of the history, s
MOVING = (Activity.RESTING, Activity.RUNNING, Activity.STOPPING)


def is_live(snapshot: Snapshot, topic: str, now: float) -> bool:
    """Return True if a message of a topic was received within `STALE_S`."""
    received_s = snapshot.received.get(topic)
    return received_s is not None and now - received_s <= STALE_S


def live_twin(snapshot: Snapshot, now: float) -> StateRecord | None:
    """Return the state of the twin; None if it is silent."""
    return snapshot.twin if is_live(snapshot, "twin/state", now) else None


def missing_sources(snapshot: Snapshot, now: float) -> list[str]:
    """Return a text for each source that does not publish; none if the driver is missing or inactive."""
    driver = snapshot.driver
    if driver is None or driver.state is Activity.INACTIVE:
        return []
    texts = []
    for topic, name in SOURCES.items():
        received_s = snapshot.received.get(topic)
        if received_s is None:
            texts.append(f"{name}: no message yet")
        elif now - received_s > STALE_S:
            texts.append(f"{name}: silent for {now - received_s:.0f} s")
    return texts


def state_text(snapshot: Snapshot, *, stopping: bool = False) -> str:
    """Return the state of the driver in a few words.

    Args:
        snapshot: latest state of the robot.
        stopping: True from a press of STOP to the driver's answer.
    """
    driver = snapshot.driver
    if driver is None:
        return "no driver"
    if driver.holding:
        text = "stopped, holding"
    elif stopping:
        text = f"STOP is not confirmed yet, {driver.state.name.lower()}"
    elif driver.state is Activity.INACTIVE:
        text = f"inactive: {driver.message}" if driver.message else "inactive"
    else:
        text = driver.state.name.lower()
    if driver.state in MOVING and driver.cycle:
        text += f", cycle {driver.cycle} of {driver.cycles}" if driver.cycles else ""
    if driver.state is Activity.FAULT and driver.message:
        text += f": {driver.message}"
    return f"emergency stop, {text}" if driver.emergency_stop else text


def twin_text(snapshot: Snapshot, now: float) -> str:
    """Return the health of the robot according to the twin, with the delay of the twin."""
    health = snapshot.health
    if health is None or not is_live(snapshot, "twin/residuals", now):
        return "twin: no message"
    age = f"{snapshot.twin_age:.1f} s behind" if math.isfinite(snapshot.twin_age) else ""
    unknown = "nothing to compare with yet" if health is Health.UNKNOWN else ""
    parts = (f"twin: {health.name.lower()}", snapshot.health_message or unknown, age)
    return ", ".join(part for part in parts if part)


def obstacles(snapshot: Snapshot, forbidden: str, hindrance: str) -> dict[str, str]:
    """Return the reason why each action is impossible now, by action; the reason is empty for a possible action.

    "Deactivate" is possible during another command, too, for example while a recording closes after STOP.

    Args:
        snapshot: latest state of the robot.
        forbidden: reason why no action is permitted.
        hindrance: reason why no other command can begin now.
    """
    driver = snapshot.driver
    if forbidden or driver is None:
        why = forbidden or "there is no driver"
        return dict.fromkeys(("Home", "Activate", "Deactivate", "Run"), why)
    off = driver.state is Activity.INACTIVE
    moving = "the robot moves" if driver.state in MOVING else ""
    blocked = "the emergency stop is on" if driver.emergency_stop else ""
    fault = "FAULT: remove the cause, then Deactivate" if driver.state is Activity.FAULT else ""
    return {
        "Home": hindrance or moving or ("" if off else "the driver is active: Deactivate first"),
        "Activate": hindrance or blocked or ("" if off else "the driver is active already"),
        "Deactivate": (hindrance and moving) or ("the driver is inactive already" if off else ""),
        "Run": hindrance
        or blocked
        or moving
        or fault
        or ("the driver is inactive: Activate first" if off else ""),
    }


def margin_text(twin: StateRecord | None) -> str:
    """Return the grooves per cycle with what they have to spare, and the groove phase; empty without a twin."""
    if twin is None:
        return ""
    keeps = twin.keeps_probability
    value = f"{keeps:.3f}" if keeps < 0.9985 else "above 0.998"
    chance = f"kept with the measured probability {value}" if math.isfinite(keeps) else ""
    phase = f"groove phase {1e3 * twin.groove_phase:.1f} mm"
    return "; ".join(filter(None, (spare_of(twin), chance, phase)))


def sample(snapshot: Snapshot, now: float) -> dict[str, float]:
    """Return the present lengths (m) and powers (W) by name; NaN for silent topics.

    ``time`` (s, monotonic clock) is that of the values. ``estimated`` and ``predicted`` come from the twin and hold for
    the time ``twin_age`` (s) earlier.
    """
    lengths = {
        source.name.lower(): snapshot.lengths.get(source, math.nan)
        if is_live(snapshot, f"body_length/{source.name.lower()}", now)
        else math.nan
        for source in LengthSource
    }
    twin = live_twin(snapshot, now)
    return {
        "time": now,
        **lengths,
        "power": snapshot.power if is_live(snapshot, "power", now) else math.nan,
        "predicted": math.nan if twin is None else twin.power,
        "twin_age": snapshot.twin_age if math.isfinite(snapshot.twin_age) else 0.0,
    }
