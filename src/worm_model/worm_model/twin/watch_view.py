# SPDX-License-Identifier: Apache-2.0
"""The live terminal view: what is known of robot and twin, drawn as lines of text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
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
LEVELS = "▁▂▃▄▅▆▇█"  # of a trend
NAN = math.nan


@dataclass(frozen=True)
class Trend:
    """The last so many seconds, a value a second, the newest last; NaN where there was none.

    ``difference`` is that of x1, robot less twin, in m, ``power`` the measured one in W.
    """

    difference: Sequence[float] = ()
    power: Sequence[float] = ()


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


def render(view: View, pitch: float, width: int = 80, trend: Trend = Trend()) -> list[str]:
    """The screen, line by line, no wider than ``width`` characters (40 at least) but for colours."""
    doing = "no driver" if view.activity is None else view.activity.name.lower()
    progress = f"  cycle {view.cycle} of {view.cycles}" if view.cycles else ""
    health = f"twin  {view.health.name.lower()}  {view.message}"
    cell = min(12, (width - 14) // 3)
    heads = " ".join(
        f"{head:>{cell}}" for head in ("twin", "robot", "difference" if cell >= 10 else "diff")
    )
    return [
        *_wrapped(f"worm  {doing}  {view.gait}{progress}", width),
        *_wrapped(health, width, HEALTH_COLOURS[view.health]),
        *(_wrapped(", ".join(view.silent), width, STALE_COLOUR) or [""]),
        *pipe(view, pitch, width),
        "",
        f"{'':14}{heads}",
        _compared("x1", 1e3, "mm", (view.twin[0], view.robot[0]), cell),
        _compared("x2", 1e3, "mm", (view.twin[1], view.robot[1]), cell),
        _compared("power", 1.0, "W", view.power, cell),
        _compared("energy", 1.0, "J", (view.energy[0], view.energy[0] + view.energy[1]), cell),
        "",
        f"length        {_value(view.length, 1e3)} mm  {_source(view)}",
        f"L0            {_value(view.initial_length, 1e3)} mm",
        f"groove phase  {_value(view.groove_phase, 1e3)} mm",
        f"cable force   {_value(view.cable_force, 1.0)} N",
        f"grooves       rear {view.grooves[0]:+d}, front {view.grooves[1]:+d}",
        "",
        bar("predicted", view.power[0], width),
        bar("measured", view.power[1], width),
        "",
        *_trend("x1, robot−twin", 1e3, "mm", trend.difference, width),
        *_trend("measured power", 1.0, "W", trend.power, width),
    ]


def _wrapped(text: str, width: int, colour: str = "") -> list[str]:
    """A text in as many lines as it takes."""
    lines = textwrap.wrap(text, width, subsequent_indent="      ", drop_whitespace=True)
    return [f"{colour}{line}{RESET}" if colour else line for line in lines]


def _trend(name: str, scale: float, unit: str, values: Sequence[float], width: int) -> list[str]:
    """What a value did of late, between the least and the greatest of it; nothing where there was none."""
    values = values[-width:]
    known = [scale * value for value in values if math.isfinite(value)]
    if not known:
        return []
    low, high = min(known), max(known)
    step = (high - low) / (len(LEVELS) - 1) or 1.0
    line = "".join(
        LEVELS[round((scale * value - low) / step)] if math.isfinite(value) else " "
        for value in values
    )
    return [f"{name}, {len(values)} s: {low:.2f} to {high:.2f} {unit}"[:width], line]


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


def _compared(name: str, scale: float, unit: str, values: tuple[float, float], cell: int) -> str:
    twin, robot = values
    cells = [_value(value, scale, cell) for value in (twin, robot, robot - twin)]
    return f"{name:7}{unit:7}{' '.join(cells)}"


def _value(value: float, scale: float, width: int = 8) -> str:
    return "-".rjust(width) if math.isnan(value) else f"{value * scale:{width}.2f}"


def _source(view: View) -> str:
    return "" if view.source is None else f"({view.source.name.lower()})"
