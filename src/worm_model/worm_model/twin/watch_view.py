# SPDX-License-Identifier: Apache-2.0
"""Live terminal view of robot and twin, as lines of text."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import Health

HEALTH_COLOURS = {
    Health.UNKNOWN: "\033[90m",
    Health.HEALTHY: "\033[32m",
    Health.SUSPECT: "\033[33m",
    Health.FAULTY: "\033[31m",
}
STALE_COLOUR = "\033[31m"
STALE_S = 1.0  # time without input after which a source is silent
SOURCES = ("driver", "twin", "tracker", "power")
#: fields of a `View` with values of the twin only
OF_TWIN = (
    *("health", "message", "source", "twin", "rear_anchor", "grooves", "length"),
    *("initial_length", "groove_phase", "cable_force", "energy", "spare"),
)
RESET = "\033[0m"
CLEAR = "\033[H\033[J"
TOP_POWER_W = 15.0  # power at which a bar has its full length
LEVELS = "▁▂▃▄▅▆▇█"  # characters of a trend
NAN = math.nan


@dataclass(frozen=True)
class Trend:
    """Values of the last seconds, one per second, the newest last; NaN for a second without a value.

    Attributes:
        difference: x1 of the robot minus x1 of the twin, m.
        power: measured power, W.
    """

    difference: Sequence[float] = ()
    power: Sequence[float] = ()


@dataclass(frozen=True)
class View:
    """Latest values in SI units, NaN for a number that has not arrived yet. Positions are in the tracker's frame.

    Pairs of positions are (x1, x2), pairs of grooves (rear, front). ``silent`` contains the messages on silent sources.
    """

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
    grooves: tuple[int, int] | None = None
    length: float = NAN
    initial_length: float = NAN
    groove_phase: float = NAN
    cable_force: float = NAN
    power: tuple[float, float] = (NAN, NAN)  # predicted, measured
    energy: tuple[float, float] = (NAN, NAN)  # predicted, measured minus predicted
    spare: str = ""  # measured margin

    def aged(self, ages: Mapping[str, float]) -> View:
        """Return the view with messages on the silent sources, and without the values of tracker, power and twin.

        The driver's state stays, because the driver publishes it only when it changes.

        ``ages`` contains the time (s) since the last input of each of `SOURCES` that has had an input.
        """
        silent = [name for name in SOURCES if ages.get(name, 0.0) > STALE_S]
        view = self
        if "tracker" in silent:
            view = replace(view, robot=(NAN, NAN))
        if "power" in silent:
            view = replace(view, power=(view.power[0], NAN))
        if "twin" in silent:
            values = {name: getattr(View, name) for name in OF_TWIN}
            view = replace(view, power=(NAN, view.power[1]), **values)
        words = tuple(f"{name} silent for {ages[name]:.0f} s" for name in silent)
        return replace(view, silent=words)


def render(view: View, pitch: float, width: int = 80, trend: Trend = Trend()) -> list[str]:
    """Return the screen, line by line, no wider than ``width`` characters (40 at least) without the colours.

    With a width of 80 characters the screen has at most 22 lines, unless a message is long. The trends are the last
    lines, because they matter least on a smaller screen.
    """
    doing = "no driver" if view.activity is None else view.activity.name.lower()
    progress = f"  cycle {view.cycle} of {view.cycles}" if view.cycles else ""
    health = f"twin  {view.health.name.lower()}  {view.message}"
    cell = min(12, (width - 16) // 3)  # after a name of 14 characters, with a space between
    heads = " ".join(
        f"{head:>{cell}}" for head in ("twin", "robot", "difference" if cell >= 10 else "diff")
    )
    return [
        *_wrapped(f"worm  {doing}  {view.gait}{progress}", width),
        *_wrapped(health, width, HEALTH_COLOURS[view.health]),
        *(_wrapped(", ".join(view.silent), width, STALE_COLOUR) or [""]),
        *pipe(view, pitch, width),
        f"{'':14}{heads}",
        _compared("x1", 1e3, "mm", (view.twin[0], view.robot[0]), cell),
        _compared("x2", 1e3, "mm", (view.twin[1], view.robot[1]), cell),
        _compared("power", 1.0, "W", view.power, cell),
        _compared("energy", 1.0, "J", (view.energy[0], view.energy[0] + view.energy[1]), cell),
        "",
        *_packed(_quantities(view), width),
        "",
        bar("predicted", view.power[0], width),
        bar("measured", view.power[1], width),
        *_trend("x1, robot−twin", 1e3, "mm", trend.difference, width),
        *_trend("measured power", 1.0, "W", trend.power, width),
    ]


def _quantities(view: View) -> list[str]:
    """Return length, L0, groove phase, cable force and grooves, each with name and unit."""
    grooves = "-" if view.grooves is None else "rear {:+d}, front {:+d}".format(*view.grooves)
    return [
        f"length {_value(view.length, 1e3)} mm {_source(view):11}",
        f"L0 {_value(view.initial_length, 1e3)} mm",
        f"groove phase {_value(view.groove_phase, 1e3)} mm",
        f"cable force {_value(view.cable_force, 1.0)} N",
        f"grooves: {grooves}",
        *([view.spare] if view.spare else []),
    ]


def _packed(items: Sequence[str], width: int) -> list[str]:
    """Return the items in their order, in as few lines as possible."""
    lines = [items[0]]
    for item in items[1:]:
        if len(lines[-1]) + 3 + len(item) <= width:
            lines[-1] += f"   {item}"
        else:
            lines.append(item)
    return lines


def _wrapped(text: str, width: int, colour: str = "") -> list[str]:
    """Return a text as lines of at most ``width`` characters, coloured if a colour is given."""
    lines = textwrap.wrap(text, width, subsequent_indent="      ", drop_whitespace=True)
    return [f"{colour}{line}{RESET}" if colour else line for line in lines]


def _trend(name: str, scale: float, unit: str, values: Sequence[float], width: int) -> list[str]:
    """Return a title and a line with one bar per value, scaled from minimum to maximum; empty without values."""
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
    """Return three lines centred on the twin: the twin, the ridges of the pipe, the robot."""
    centre = 0.5 * sum(view.twin)
    if not math.isfinite(centre):
        return ["(no twin)", "", ""]
    scale = 0.6 / width  # m per character
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
    """Return a bar for a power (W), with the full scale ``TOP_POWER_W``."""
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
