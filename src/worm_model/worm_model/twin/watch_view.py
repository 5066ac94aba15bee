# SPDX-License-Identifier: Apache-2.0
"""The live terminal view: what is known of robot and twin, drawn as lines of text."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from worm_model.twin.records import Activity, Health, LengthSource

HEALTH_COLOURS = {
    Health.UNKNOWN: "\033[90m",
    Health.HEALTHY: "\033[32m",
    Health.SUSPECT: "\033[33m",
    Health.FAULTY: "\033[31m",
}
STALE_COLOUR = "\033[31m"
STALE_S = 1.0  # beyond this age a value is not shown as the present
SOURCES = ("driver", "twin", "tracker", "power")
RESET = "\033[0m"
CLEAR = "\033[H\033[J"
TOP_POWER_W = 15.0  # of the bar
NAN = math.nan


@dataclass(frozen=True)
class View:
    """The newest of everything, SI; NaN what has not come yet, positions in the tracker's frame."""

    activity: Activity | None = None
    gait: str = ""
    cycle: int = 0
    cycles: int = 0
    health: Health = Health.UNKNOWN
    message: str = ""
    source: LengthSource | None = None
    twin: tuple[float, float] = (NAN, NAN)
    robot: tuple[float, float] = (NAN, NAN)
    rear_anchor: float = NAN
    silent: tuple[str, ...] = ()
    grooves: tuple[int, int] = (0, 0)
    length: float = NAN
    initial_length: float = NAN
    groove_phase: float = NAN
    cable_force: float = NAN
    power: tuple[float, float] = (NAN, NAN)  # predicted, measured
    energy: tuple[float, float] = (NAN, NAN)  # predicted, measured minus predicted

    def aged(self, ages: Mapping[str, float]) -> View:
        """The view without what is stale; ``ages`` in s since something came, by `SOURCES`, a missing one never did.

        What is missing is left to its own words; what came once and stopped is named in the message.
        """
        silent = [name for name in SOURCES if ages.get(name, 0.0) > STALE_S]
        view = self
        if "tracker" in silent:
            view = replace(view, robot=(NAN, NAN))
        if "power" in silent:
            view = replace(view, power=(view.power[0], NAN))
        if "twin" in silent:
            view = replace(view, health=Health.UNKNOWN, message="")
        words = tuple(f"{name} silent for {ages[name]:.0f} s" for name in silent)
        return replace(view, silent=words)


def render(view: View, pitch: float, width: int = 80) -> list[str]:
    """The screen, line by line, no wider than ``width`` characters but for colours."""
    doing = "no driver" if view.activity is None else view.activity.name.lower()
    progress = f"  cycle {view.cycle} of {view.cycles}" if view.cycles else ""
    colour = HEALTH_COLOURS[view.health]
    return [
        f"worm  {doing}  {view.gait}{progress}"[:width],
        f"{colour}{f'twin  {view.health.name.lower()}  {view.message}'[:width]}{RESET}",
        f"{STALE_COLOUR}{', '.join(view.silent)[:width]}{RESET}" if view.silent else "",
        *pipe(view, pitch, width),
        "",
        f"              {'twin':>12} {'robot':>12} {'difference':>12}",
        _compared("x1", 1e3, "mm", view.twin[0], view.robot[0]),
        _compared("x2", 1e3, "mm", view.twin[1], view.robot[1]),
        _compared("power", 1.0, "W", *view.power),
        _compared("energy", 1.0, "J", view.energy[0], view.energy[0] + view.energy[1]),
        "",
        f"length        {_value(view.length, 1e3)} mm  {_source(view)}",
        f"L0            {_value(view.initial_length, 1e3)} mm  "
        f"groove phase {1e3 * view.groove_phase:+.2f} mm",
        f"cable force   {_value(view.cable_force, 1.0)} N",
        f"grooves       rear {view.grooves[0]:+d}, front {view.grooves[1]:+d}",
        "",
        bar("predicted", view.power[0], width),
        bar("measured", view.power[1], width),
    ]


def pipe(view: View, pitch: float, width: int) -> list[str]:
    """The pipe's ridges with the twin above and the robot below them, the view following the twin."""
    centre = 0.5 * sum(view.twin)
    if not math.isfinite(centre):
        return ["(no twin yet)", "", ""]
    scale = 0.6 / width  # m a character
    left = centre - 0.5 * width * scale

    def column(position: float) -> int:
        return math.floor((position - left) / scale)

    ridges = [" "] * width
    first = math.ceil((left - view.rear_anchor) / pitch - 0.5)
    for k in range(first, first + math.ceil(0.6 / pitch) + 1):
        at = column(view.rear_anchor + (k + 0.5) * pitch)
        if 0 <= at < width:
            ridges[at] = "^"
    return [
        _worm("twin ", *view.twin, width=width, column=column),
        "".join(ridges),
        _worm("robot", *view.robot, width=width, column=column),
    ]


def _worm(name: str, rear: float, front: float, width: int, column: Callable[[float], int]) -> str:
    cells = [" "] * width
    cells[: len(name)] = name
    if math.isfinite(rear) and math.isfinite(front):
        first, last = max(column(rear), 0), min(column(front), width - 1)
        for k in range(first, last + 1):
            cells[k] = "~"
        for end in (first, last):
            if 0 <= end < width:
                cells[end] = "#"
    return "".join(cells)


def bar(name: str, power: float, width: int) -> str:
    """A bar of power up to ``TOP_POWER_W``."""
    room = width - 24
    filled = 0 if math.isnan(power) else round(min(max(power / TOP_POWER_W, 0.0), 1.0) * room)
    return f"{name:10} {_value(power, 1.0)} W {'█' * filled}"


def _compared(name: str, scale: float, unit: str, twin: float, robot: float) -> str:
    cells = [_value(value, scale, 12) for value in (twin, robot, robot - twin)]
    return f"{name:7} {unit:5} {' '.join(cells)}"


def _value(value: float, scale: float, width: int = 8) -> str:
    return "-".rjust(width) if math.isnan(value) else f"{value * scale:{width}.2f}"


def _source(view: View) -> str:
    return "" if view.source is None else f"({view.source.name.lower()})"
