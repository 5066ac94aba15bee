# SPDX-License-Identifier: Apache-2.0
"""Draws the pictures of the model that the pages show, each computed from the model. Run by `./worm docs`."""

from __future__ import annotations

import dataclasses
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from worm_model.analysis.plot_style import (
    BLUE,
    COMMANDED,
    DPI,
    EFFECTIVE,
    MEASURED,
    MM,
    VERMILION,
    finish,
    letter,
    new_figure,
)
from worm_model.analysis.simulated_run import simulated_run
from worm_model.gait import FORWARD, Gait
from worm_model.margin.half_cycles import Fin, Motion, half_cycles
from worm_model.margin.run_switches import run_switches
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.actuation import effective_command
from worm_model.simulation.simulator import Locomotion, simulate
from worm_model.simulation.smoothing import smooth
from worm_model.twin.scene import FREE, HOLDING, YIELDING
from worm_optimizer.evaluation.task import Bounds
from worm_optimizer.report.front_plots import capability_figure, price_figure
from worm_optimizer.search.capability import capabilities, curve, strongest
from worm_optimizer.search.front import RobustFront, make_front, scanned_price
from worm_optimizer.search.search_settings import Settings, settings_of

# Set by a test that every picture is drawn: fronts at one frequency take seconds, not a minute.
COARSE = "WORM_COARSE_PICTURES" in os.environ
FOLDER = Path(__file__).with_name("figures") / "model"
GAIT = Gait(stroke=0.07, frequency=0.2)
WIDTH = 8.5  # inches
ARROW: Mapping[str, Any] = {"arrowstyle": "<|-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
POINTER: Mapping[str, Any] = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
LOOSE = "#FFF3CF"  # where the cable is slack
p = PAPER


def _dimension(axes: Axes, left: float, right: float, y: float, text: str) -> None:
    """Draw a dimension line between two positions, its text above its middle; mm."""
    axes.annotate("", (left, y), (right, y), arrowprops=ARROW)
    axes.text(0.5 * (left + right), y + 2.0, text, ha="center", va="bottom")


def fin_force_picture() -> Figure:
    """Plot the force of a fin over its deflection, as the simulator has it."""
    limit, half = p.switching_threshold, 0.5 * p.clearance
    deflection = np.union1d(np.linspace(-limit, limit, 401), [-half, half])
    force = np.array([_force_at(x) for x in deflection])
    figure = new_figure(WIDTH, 4.6)
    axes = figure.subplots()
    for inside, colour, name in (
        (deflection <= -half, HOLDING, "deflected backward: holds"),
        (np.abs(deflection) <= half, FREE, "within the clearance: touches nothing"),
        (deflection >= half, YIELDING, "deflected forward: yields"),
    ):
        axes.plot(MM * deflection[inside], force[inside], color=colour, linewidth=4.0, label=name)
    for side, sign in ((-1.0, "−"), (1.0, "+")):
        axes.axvline(side * MM * limit, color="black", linestyle="--", linewidth=1.0)
        axes.text(
            side * (MM * limit - 0.4),
            -13.0 if side > 0 else 3.0,
            f"threshold {sign}$p_\\mathrm{{sw}}$:\nbeyond it the fin\nslips {'forward' if side > 0 else 'backward'}",
            ha="right" if side > 0 else "left",
            va="center",
        )
    axes.text(
        -10.0,
        -15.5,
        f"slope $k_\\mathrm{{eng}}$ = {p.engaged_stiffness:.0f} N/m",
        color=HOLDING[:3],
    )
    axes.text(
        6.5,
        5.2,
        f"slope $k_\\mathrm{{dis}}$ = {p.disengaged_stiffness:.0f} N/m",
        ha="center",
        color="#A86200",
    )
    _dimension(axes, -MM * half, MM * half, -2.2, "")
    axes.text(
        0.0,
        -3.0,
        f"clearance $\\delta_\\mathrm{{c}}$ = {MM * p.clearance:.2f} mm",
        ha="center",
        va="top",
    )
    axes.set(xlabel="deflection of the fin, x − A (mm)", ylim=(-27.0, 8.0))
    finish(axes, "force f of the fin (N)")
    axes.margins(x=0.02)
    return figure


def _force_at(deflection: float) -> float:
    """Return the force (N) of a rear fin that is deflected by so much (m)."""
    model = Locomotion(p)
    _, motions = model.follow(model.start(x1=deflection), [0.0], [0.0])
    return float(motions.rear_force[0])


def cable_slack_picture() -> Figure:
    """Plot command and length change over time, and against each other."""
    run = simulated_run(GAIT, p, 3, 100.0)
    change = run.motions.length - p.initial_length
    figure = new_figure(WIDTH, 4.6)
    over_time, loop = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    over_time.plot(run.time, MM * run.command, label="command $u_\\mathrm{cmd}$", **COMMANDED)
    effective = MM * effective_command(run.command, p.slack)
    over_time.plot(run.time, effective, label="effective $u_\\mathrm{eff}$", **EFFECTIVE)
    over_time.plot(run.time, MM * change, label="length change ΔL", **MEASURED)
    over_time.axhspan(-MM * p.slack, 0.0, color=LOOSE, zorder=0)
    loop.axvspan(-MM * p.slack, 0.0, color=LOOSE, zorder=0)
    steady = run.time >= 2.0 * GAIT.period
    loop.plot(MM * run.command[steady], MM * change[steady], **MEASURED)
    note = f"slack $\\delta_\\mathrm{{s}}$ = {MM * p.slack:.0f} mm:\nno effect"
    loop.annotate(note, (-4.0, -46.0), (-11.0, -53.0), arrowprops=POINTER, ha="right", va="center")
    loop.text(-50.0, -26.0, "contracting", ha="center", color=BLUE)
    loop.text(-22.0, -36.0, "extending", ha="center", color=BLUE)
    loop.set_xlabel("command $u_\\mathrm{cmd}$ (mm)")
    over_time.set_xlabel("time (s)")
    finish(over_time, "change of length (mm)")
    finish(loop, "length change ΔL (mm)")
    letter((over_time, loop))
    return figure


def price_picture() -> Figure:
    """Plot the price of robustness of the paper's parameters under the default settings."""
    return price_figure(scanned_price(ParameterFile(), _settings(), FORWARD))


def _settings(**changes: object) -> Settings:
    """Return the default settings with changes."""
    settings = settings_of(changes)
    if COARSE:
        settings = dataclasses.replace(
            settings, bounds=Bounds(frequency_low=0.15, frequency_high=0.15)
        )
    return settings


@cache
def _front(waveform: str, margin: float) -> RobustFront:
    """Return the front of the paper's parameters over gaits of a waveform at a margin (m)."""
    settings = _settings(waveform=waveform, margin_m=margin, samples=1)
    return make_front(ParameterFile(), settings, FORWARD)


def waveforms_picture() -> Figure:
    """Plot the cycle of the paper's cruise and of the shaped cruise: command, length change and power."""
    figure = new_figure(WIDTH, 4.8)
    panels = figure.subplots(2, 2, sharex="col", sharey="row")
    for (above, below), name in zip(panels.T, ("sinusoid", "shaped"), strict=True):
        cruise = _front(name, 0.0).three["cruise"]
        run = simulated_run(cruise.gait, p, 3, 200.0)
        cycle = run.time >= 2.0 * cruise.period
        time = run.time[cycle] - 2.0 * cruise.period
        change = run.motions.length[cycle] - p.initial_length
        above.plot(time, MM * run.command[cycle], label="command", **COMMANDED)
        above.plot(time, MM * change, label="length change", **MEASURED)
        below.plot(time, run.motions.power[cycle], **MEASURED)
        below.axhline(cruise.power, color=VERMILION, linestyle="--", linewidth=1.0)
        below.set_xlabel("time (s)")
        note = f"{name}: f = {cruise.frequency:.3f} Hz, cost of transport {cruise.cost_of_transport:.1f}"
        above.set_title(note, loc="left", fontsize="small")
        for axes in (above, below):
            axes.grid(visible=True, linewidth=0.4)
    panels[0, 0].set_ylabel("mm")
    panels[1, 0].set_ylabel("power (W)")
    panels[0, 1].legend(loc="upper center", fontsize="small", frameon=False)
    return figure


def waveform_gain_picture() -> Figure:
    """Plot the fronts of both waveforms at two margins."""
    figure = new_figure(WIDTH, 4.2)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, margin in zip(panels, (0.0, 3.4e-3), strict=True):
        for name, color, marker in (("sinusoid", BLUE, "o"), ("shaped", VERMILION, "s")):
            gaits = _front(name, margin).gaits
            speeds, powers = (
                [getattr(gait, field) for gait in gaits] for field in ("speed", "power")
            )
            axes.plot(
                MM * np.array(speeds), powers, color=color, marker=marker, ms=3, lw=0.0, label=name
            )
        axes.set_xlabel("speed (mm/s)")
        axes.set_title(f"margin {MM * margin:.1f} mm", loc="left", fontsize="small")
        axes.grid(visible=True, linewidth=0.4)
    panels[0].set_ylabel("power (W)")
    panels[0].legend(loc="upper left", fontsize="small", frameon=False)
    letter(tuple(panels))
    return figure


def capability_picture() -> Figure:
    """Plot the largest loads of the paper's robot, and the price of a load."""
    front = _front("sinusoid", 3.4e-3)
    task = front.nominal
    gaits = {name: each.gait for name, each in front.three.items()}
    best = strongest(task)
    assert best is not None
    gaits["best"] = best
    found = dict(zip(gaits, capabilities(task, list(gaits.values())), strict=True))
    return capability_figure(found, curve(task, found["best"].largest_load))


def measured_margin_picture() -> Figure:
    """Plot what the measurement of the margin sees: the length, and the saw-tooth of the module that holds."""
    gait = Gait(stroke=0.077, frequency=0.2)
    motion, rear, front = _camera(gait, cycles=5)
    halves = half_cycles(motion, gait, 5)[4:6]  # of the third cycle
    found = run_switches(motion, half_cycles(motion, gait, 5), p)
    figure = new_figure(WIDTH, 5.6)
    length, holding = figure.subplots(2, 1, sharex=True)
    length.plot(motion.time, MM * motion.length, **MEASURED)
    for half, module, colour in zip(halves, (front, rear), (BLUE, VERMILION), strict=True):
        seen = (motion.time > half.start) & (motion.time < half.end)
        name = "front" if half.fin is Fin.REAR else "rear"
        own = module[seen] - module[seen][0]
        holding.plot(
            motion.time[seen], MM * own, ".", ms=3, color=colour, label=f"{name} module, holds"
        )
        times = found[half.fin].switches[2].times
        for axes in (length, holding):
            for time in times:
                axes.axvline(time, color=colour, lw=0.8, ls=":")
        last = float(motion.length_at(times[-1]))
        ends = MM * last, MM * half.end_length
        length.plot([times[-1]] * 2, ends, lw=4, color=colour, solid_capstyle="butt")
        spare, below = abs(ends[0] - ends[1]), half.fin is Fin.FRONT
        length.text(
            times[-1] + 0.1,
            ends[0] + (-9 if below else 3),
            f"{half.fin.value}: {spare:.1f} mm left",
            fontsize="small",
        )
    holding.text(
        halves[0].start + 1.1,
        -7.0,
        "a switch of the sliding fin\nreleases the holding module",
        fontsize="small",
    )
    length.set_ylabel("body length (mm)")
    holding.set_ylabel("holding module (mm)")
    holding.set_xlabel("time (s)")
    holding.legend(fontsize="small", frameon=False)
    holding.set_xlim(halves[0].start, halves[1].end + 0.2)
    letter((length, holding))
    return figure


def _camera(gait: Gait, cycles: int) -> tuple[Motion, np.ndarray, np.ndarray]:
    """Return the motion of a gait as a camera with 30 Hz and a noise of 0.15 mm sees it, and both positions."""
    time = np.arange(0.0, (cycles + 0.5) * gait.period, 1.0 / 30.0)
    states = simulate(gait, p, cycles + 1).at(time)
    noise = np.random.default_rng(1).normal(0.0, 0.15e-3, (2, time.size))
    rear, front = states.x1 + noise[0], states.x2 + noise[1]
    length = smooth(time, front - rear, time, 0.08, 0.08).value
    whole = np.isfinite(length)
    rear, front = rear[whole], front[whole]
    motion = Motion(time[whole], rear, front, length[whole], 0.15e-3, cycles * gait.period)
    return motion, rear, front


PICTURES: Mapping[str, Callable[[], Figure]] = {
    "fin_force": fin_force_picture,
    "cable_slack": cable_slack_picture,
    "price_of_robustness": price_picture,
    "waveforms": waveforms_picture,
    "waveform_gain": waveform_gain_picture,
    "capability": capability_picture,
    "measured_margin": measured_margin_picture,
}


def _write_png(figure: Figure, path: Path) -> None:
    """Write a figure with a palette, which makes it a third of the size."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    with Image.open(buffer) as image:
        colours = image.convert("RGB")
    colours.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


def main(folder: Path) -> None:
    """Write all pictures into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in PICTURES.items():
        _write_png(draw(), folder / f"{name}.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
