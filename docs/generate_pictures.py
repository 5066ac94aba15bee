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

from worm_model.analysis import robot_drawing
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
from worm_model.parameters import PAPER, ParameterFile, Parameters
from worm_model.simulation.actuation import effective_command
from worm_model.simulation.closed_form import front_groove, groove_phase
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
STEADY = (
    2 * GAIT.period
)  # the third cycle begins; the first two differ, as the robot starts from rest
WIDTH = 8.5  # inches
ROOM = 0.05  # m of pipe drawn behind and before the robot
BELOW, ABOVE = -robot_drawing.WALL_RADIUS, robot_drawing.WALL_RADIUS  # mm, outside of the walls
ARROW: Mapping[str, Any] = {"arrowstyle": "<|-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
POINTER: Mapping[str, Any] = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "shrinkB": 0}
RED: Mapping[str, Any] = {"color": VERMILION}
LOOSE = "#FFF3CF"  # where the cable is slack
p = PAPER


def pose_of(time: float) -> robot_drawing.Pose:
    """Return the pose of the gait at a time in s."""
    motions = simulate(GAIT, p).at([time])
    return robot_drawing.pose_at(motions, np.array([GAIT.command(time)]), p, 0)


def robot_picture() -> Figure:
    """Draw the robot in its pipe with every symbol of the model."""
    figure = new_figure(WIDTH, 6.6)
    whole, below = figure.subfigures(2, 1, height_ratios=(1.0, 1.05))
    rear, front = below.subplots(1, 2)
    pose = pose_of(STEADY + 1.7)  # contracted: the front fins hold, the rear fins yield
    _label_robot(whole.subplots(), pose)
    notes = "deflected forward: it yields", "deflected backward: it holds"
    ends = (pose.x1, pose.rear_anchor), (pose.x2, pose.front_anchor)
    for axes, (x, anchor), name, note in zip((rear, front), ends, "12", notes, strict=True):
        _label_fin(axes, pose, x, anchor, name)
        axes.set_title(f"{('Rear', 'Front')[int(name) - 1]} fin {note}", fontsize="medium")
    return figure


def _label_robot(axes: Axes, pose: robot_drawing.Pose) -> None:
    low, high = pose.x1 - ROOM, pose.x2 + 1.4 * ROOM
    robot_drawing.draw_pipe(axes, p.pitch, low, high)
    robot_drawing.RobotDrawing(axes, p).show(pose)
    robot_drawing.prepare_axes(axes, low, high, above=28.0, below=38.0)
    for name, position, anchor, label in (
        ("1", pose.x1, pose.rear_anchor, "rear module"),
        ("2", pose.x2, pose.front_anchor, "front module"),
    ):
        axes.text(MM * position, 0.0, f"$M_{name}$", ha="center", va="center", zorder=6)
        _point_at(axes, MM * anchor, ABOVE + 4.0, 12.0, f"anchor $A_{name}$")
        _point_at(axes, MM * position, BELOW - 1.0, -9.0, f"$x_{name}$, {label}")
        axes.plot(
            [MM * position] * 2,
            [-robot_drawing.MODULE_RADIUS, BELOW - 1.0],
            "k:",
            linewidth=1.0,
            zorder=6,
        )
    _dimension(axes, MM * pose.x1, MM * pose.x2, BELOW - 32.0, "body length $L = L_0 + \\Delta L$")
    groove = round(0.5 * (pose.x1 + pose.x2) / p.pitch) * p.pitch
    _dimension(axes, MM * groove, MM * (groove + p.pitch), ABOVE + 5.0, "pitch $d$")
    middle = 0.5 * MM * (pose.x1 + pose.x2)
    axes.text(middle, 2.5, "cable", ha="center", zorder=6)
    axes.text(middle, -29.0, "bellows", ha="center", zorder=6)
    place = MM * pose.x2 - 1.0, 31.0
    axes.annotate("fins", place, (place[0] - 50.0, 28.0), arrowprops=POINTER, zorder=6)
    axes.text(MM * high - 24.0, 3.0, "forward, +x", ha="center", color=VERMILION)
    axes.annotate(
        "", (MM * high - 2.0, -2.0), (MM * high - 46.0, -2.0), arrowprops={**POINTER, **RED}
    )


def _label_fin(axes: Axes, pose: robot_drawing.Pose, x: float, anchor: float, name: str) -> None:
    """Show a fin, and its deflection on a scale with the clearance and the thresholds."""
    half, threshold = 0.5 * MM * p.clearance, MM * p.switching_threshold
    low, high = anchor - 0.026, anchor + 0.026
    robot_drawing.draw_pipe(axes, p.pitch, low, high)
    robot_drawing.RobotDrawing(axes, p).show(pose)
    axes.set(xlim=(MM * low, MM * high), ylim=(-88.0, -12.0), aspect="equal")
    axes.axis("off")
    root, zero, y = MM * x, MM * anchor, -68.0
    axes.fill_between([zero - half, zero + half], y - 3.0, y + 3.0, color=FREE, alpha=0.5, lw=0.0)
    axes.plot([zero - threshold, zero + threshold], [y, y], "k", linewidth=1.0)
    for side, sign in ((-1.0, "−"), (1.0, "+")):
        axes.plot([zero + side * threshold] * 2, [y - 3.0, y + 3.0], "k", linewidth=1.5)
        axes.text(
            zero + side * threshold, y - 5.0, f"{sign}$p_\\mathrm{{sw}}$", ha="center", va="top"
        )
    axes.text(zero, y - 5.0, "$\\delta_\\mathrm{c}$", ha="center", va="top")
    axes.plot([root] * 2, [-robot_drawing.MODULE_RADIUS, y], "k:", linewidth=1.0, zorder=6)
    axes.plot([zero] * 2, [BELOW - 4.0, y], "k:", linewidth=1.0, zorder=6)
    axes.annotate("", (root, y + 6.0), (zero, y + 6.0), arrowprops={**POINTER, **RED})
    away = 1.0 if root > zero else -1.0
    axes.text(
        root + away,
        y + 6.0,
        f"$x_{name} - A_{name}$",
        ha="left" if away > 0.0 else "right",
        va="center",
        color=VERMILION,
    )


def _point_at(axes: Axes, x: float, y: float, rise: float, text: str) -> None:
    """Point an arrow at (x, y) from ``rise`` above it, with a text at its tail; mm."""
    va = "bottom" if rise > 0.0 else "top"
    axes.annotate(text, (x, y), (x, y + rise), arrowprops=POINTER, ha="center", va=va)


def _dimension(axes: Axes, left: float, right: float, y: float, text: str) -> None:
    """Draw a dimension line between two positions, its text above its middle; mm."""
    axes.annotate("", (left, y), (right, y), arrowprops=ARROW)
    axes.text(0.5 * (left + right), y + 2.0, text, ha="center", va="bottom")


def stride_picture() -> Figure:
    """Draw one stride as a strip of four frames."""
    rear, front = (
        next(
            e.time for e in simulate(GAIT).events() if e.switched and e.fin == k and e.time > STEADY
        )
        for k in (1, 2)
    )
    frames = (
        (rear - 0.02, "1. The cable contracts the body: the front fins hold, the rear fins yield."),
        (rear + 0.3, "2. The rear fins slip forward into the next groove."),
        (front - 0.02, "3. The body extends: the rear fins hold, the front fins yield."),
        (front + 0.3, "4. The front fins slip forward: the robot has gained one groove."),
    )
    poses = [pose_of(time) for time, _ in frames]
    low, high = poses[0].x1 - 0.04, poses[-1].x2 + 0.04
    figure = new_figure(7.0, 8.6)
    strip, legend = figure.subfigures(2, 1, height_ratios=(25.0, 1.0))
    before = poses[0]
    for axes, pose, (time, text) in zip(strip.subplots(4, 1), poses, frames, strict=True):
        robot_drawing.draw_pipe(axes, p.pitch, low, high)
        robot_drawing.RobotDrawing(axes, p).show(pose)
        robot_drawing.prepare_axes(axes, low, high, above=8.0)
        change = MM * (pose.x2 - pose.x1 - p.initial_length)
        axes.set_title(text, loc="left", fontsize="medium")
        middle = 0.5 * MM * (low + high)
        axes.text(
            middle,
            -27.0,
            f"t = {time - STEADY:.1f} s    ΔL = {change:.0f} mm".replace("-", "−"),
            ha="center",
            va="center",
        )
        _mark_slip(axes, before.rear_anchor, pose.rear_anchor)
        _mark_slip(axes, before.front_anchor, pose.front_anchor)
        before = pose
    robot_drawing.explain_colours(legend, loc="center")
    return figure


def _mark_slip(axes: Axes, old: float, new: float) -> None:
    """Mark an anchor that has moved with an arrow from its groove to the next."""
    if new > old:
        y = ABOVE + 5.0
        axes.annotate("", (MM * new, y), (MM * old, y), arrowprops={**POINTER, **RED, "lw": 2.0})
        axes.text(MM * old - 2.0, y, "+d", ha="right", va="center", color=VERMILION)
        axes.plot([MM * old] * 2, [BELOW, ABOVE], color=VERMILION, linestyle=":", linewidth=1.2)


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


def groove_phase_picture() -> Figure:
    """Draw the robot at rest, and how far its front module stands from its groove."""
    groove, length = front_groove(p) * p.pitch, p.initial_length
    pose = robot_drawing.Pose(0.0, length, 0.0, groove)
    figure = new_figure(WIDTH, 6.2)
    whole, below = figure.subfigures(2, 1, height_ratios=(1.0, 1.0))
    axes, (close, trimmed) = whole.subplots(), below.subplots(1, 2)
    robot_drawing.draw_pipe(axes, p.pitch, -ROOM, length + ROOM)
    robot_drawing.RobotDrawing(axes, p).show(pose)
    robot_drawing.prepare_axes(axes, -ROOM, length + ROOM, above=24.0, below=28.0)
    for k in range(front_groove(p) + 1):
        axes.text(MM * k * p.pitch, ABOVE + 5.0, str(k), ha="center", fontsize="small")
    axes.text(0.5 * MM * length, ABOVE + 14.0, "grooves, counted from the rear fins", ha="center")
    _dimension(
        axes,
        0.0,
        MM * length,
        BELOW - 18.0,
        f"initial length $L_0$ = {MM * length:.1f} mm, at rest",
    )
    _label_phase(close, p, "This robot")
    _label_phase(trimmed, p.replace(initial_length=length - 0.005), "A robot that is 5 mm shorter")
    return figure


def _label_phase(axes: Axes, parameters: Parameters, title: str) -> None:
    """Show the front module at rest, and its groove."""
    number, length = front_groove(parameters), parameters.initial_length
    groove = number * parameters.pitch
    robot_drawing.draw_pipe(axes, parameters.pitch, groove - 0.026, groove + 0.026)
    robot_drawing.RobotDrawing(axes, parameters).show(robot_drawing.Pose(0.0, length, 0.0, groove))
    axes.set(
        xlim=(MM * (groove - 0.026), MM * (groove + 0.026)), ylim=(-82.0, -12.0), aspect="equal"
    )
    axes.axis("off")
    axes.plot(
        [MM * length] * 2, [-robot_drawing.MODULE_RADIUS, -72.0], "k:", linewidth=1.0, zorder=6
    )
    axes.plot([MM * groove] * 2, [BELOW - 4.0, -72.0], "k:", linewidth=1.0, zorder=6)
    left = length < groove
    for place, text, ha in (
        (groove, f"groove {number}", "left" if left else "right"),
        (length, "$x_2$", "right" if left else "left"),
    ):
        away = 1.0 if ha == "left" else -1.0
        axes.text(MM * place + away, -62.0, text, ha=ha, va="center")
    axes.annotate("", (MM * length, -70.0), (MM * groove, -70.0), arrowprops={**POINTER, **RED})
    phase = MM * groove_phase(parameters)
    axes.text(
        MM * groove,
        -74.0,
        f"groove phase φ = $L_0$ − {number} d = {phase:+.1f} mm".replace("-", "−"),
        ha="center",
        va="top",
        color=VERMILION,
    )
    axes.set_title(title, fontsize="medium")


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
    "robot": robot_picture,
    "stride": stride_picture,
    "fin_force": fin_force_picture,
    "cable_slack": cable_slack_picture,
    "groove_phase": groove_phase_picture,
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
