# SPDX-License-Identifier: Apache-2.0
"""Animation of a simulated gait: the robot in its pipe, its length and its power, in real time, as GIF or MP4."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from PIL import Image

from worm_model.analysis.plot_style import COMMANDED, MEASURED, MM, finish
from worm_model.analysis.robot_drawing import (
    RobotDrawing,
    draw_pipe,
    explain_colours,
    pose_at,
    prepare_axes,
)
from worm_model.analysis.simulated_run import SimulatedRun
from worm_model.errors import InputError

GIF_TICK_HZ = 100.0  # a GIF stores the duration of a frame in hundredths of a second
MOST_FRAMES = 3000
_SIZE, _DPI = (8.4, 4.8), 100  # inches; 840 by 480 pixels, both even as H.264 requires
# Left, bottom, width and height of the axes of pipe, length and power, relative to the figure and equal in all frames.
_PLACES = ((0.01, 0.55, 0.98, 0.37), (0.1, 0.325, 0.88, 0.17), (0.1, 0.11, 0.88, 0.17))
_COLOURS = 128  # largest number of colours in a palette
_DISTANCE = 8  # of 255; any two colours of a palette differ by at least this in red, green or blue
_ROOM = 0.07  # m of pipe shown behind and ahead of the robot
_MOST_TRAVEL = 0.2  # m; if the robot crawls farther than this, the view follows it


def check_animation(path: Path, rate: float, frames: float) -> None:
    """Raise `InputError` unless an animation with a number of ``frames`` at a rate in Hz can be written to ``path``."""
    if frames > MOST_FRAMES:
        raise InputError(
            f"--output {path}: {frames:.0f} frames at --rate {rate:g} Hz; an animation may have at most {MOST_FRAMES}. "
            "Use fewer --cycles or a lower --rate."
        )
    ticks = GIF_TICK_HZ / rate
    if path.suffix.lower() == ".gif" and (ticks < 2.0 or abs(ticks - round(ticks)) > 1e-9):
        raise InputError(
            f"--rate {rate:g}: a GIF shows a frame for whole hundredths of a second, at least two. "
            "Use 10, 12.5, 20, 25 or 50 Hz."
        )
    if path.suffix.lower() == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(
            f"--output {path}: writing .mp4 requires ffmpeg, which is not installed. Install it, or write a .gif."
        )


def write_animation(run: SimulatedRun, path: Path, report: Callable[[float], None]) -> None:
    """Write a run as an animation in real time, with one frame per sample.

    ``report`` is called with the fraction done, 0 to 1. After an exception, the unfinished file is removed.
    """
    figure, moving, show = animated_figure(run)
    write = partial(_write_gif, moving) if path.suffix.lower() == ".gif" else _write_mp4
    rate = 1.0 / float(run.time[1] - run.time[0])

    def shown() -> Iterator[int]:
        for index in range(run.time.size):
            show(index)
            yield index
            report((index + 1) / run.time.size)

    try:
        write(figure, shown(), rate, path)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _write_gif(
    moving: Sequence[Artist], figure: Figure, shown: Iterator[int], rate: float, path: Path
) -> None:
    """Write a frame for each shown index; all frames use the palette of the first frame.

    All but the ``moving`` parts are drawn only once.
    """
    canvas = FigureCanvasAgg(figure)
    for part in moving:
        part.set_animated(True)  # then the canvas does not draw it
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)

    def frames() -> Iterator[Image.Image]:
        palette: Image.Image | None = None
        for _ in shown:
            canvas.restore_region(background)
            for part in moving:
                figure.draw_artist(part)
            frame = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
            palette = palette or palette_of(frame)
            yield frame.quantize(palette=palette, dither=Image.Dither.NONE)

    images = frames()
    first = next(images)
    milliseconds = round(1e3 / rate)
    first.save(path, save_all=True, append_images=images, duration=milliseconds, loop=0)


def palette_of(image: Image.Image) -> Image.Image:
    """Return a palette for `Image.quantize`: the most frequent colours of an RGB image, without similar ones.

    The colours of large uniform areas stay unchanged, which Pillow's own palettes do not guarantee.
    """
    red, green, blue = np.moveaxis(np.asarray(image, np.int32), 2, 0)
    packed, counts = np.unique(red << 16 | green << 8 | blue, return_counts=True)
    chosen = np.empty((0, 3), int)
    for number in packed[np.argsort(-counts)]:
        colour = np.array([number >> 16, number >> 8 & 0xFF, number & 0xFF])
        if np.all(np.abs(chosen - colour).max(axis=1) >= _DISTANCE):
            chosen = np.vstack([chosen, colour])
        if len(chosen) == _COLOURS:
            break
    palette = Image.new("P", (1, 1))
    palette.putpalette(chosen.ravel().tolist())
    return palette


def _write_mp4(figure: Figure, shown: Iterator[int], rate: float, path: Path) -> None:
    writer = FFMpegWriter(fps=rate, codec="h264")  # type: ignore[arg-type]  # fractions are accepted
    with writer.saving(figure, str(path), _DPI):
        for _ in shown:
            writer.grab_frame()


def animated_figure(
    run: SimulatedRun,
) -> tuple[Figure, Sequence[Artist], Callable[[int], None]]:
    """Return a figure, its moving parts, and the function that shows the sample with a given index in this figure."""
    figure = Figure(figsize=_SIZE, dpi=_DPI)
    pipe, length, power = (figure.add_axes(place) for place in _PLACES)
    advanced = figure.text(0.01, 0.95, "")
    move_robot = _animated_robot(pipe, advanced, run)
    change = MM * (run.motions.length - run.parameters.initial_length)
    length.plot(run.time, MM * run.command, label="commanded", **COMMANDED)
    length.plot(run.time, change, label="realised", **MEASURED)
    power.plot(run.time, run.motions.power, **MEASURED)
    dots = [_dot(length), _dot(power)]
    finish(length, "length\nchange (mm)")
    finish(power, "power (W)")
    power.set_ylim(bottom=0.0)
    length.tick_params(labelbottom=False)
    power.set_xlabel("time since the gait's onset (s)")
    figure.align_ylabels()

    def show(index: int) -> None:
        move_robot(index)
        for dot, values in zip(dots, (change, run.motions.power), strict=True):
            dot.set_data([run.time[index]], [values[index]])

    return figure, [pipe, advanced, *dots], show


def _dot(axes: Axes) -> Line2D:
    return axes.plot([], [], "o", color="black", markersize=6, zorder=6)[0]


def _animated_robot(axes: Axes, advanced: Text, run: SimulatedRun) -> Callable[[int], None]:
    """Draw the pipe and the robot, and return the function that shows the sample with a given index.

    The text ``advanced`` shows the time and the grooves gained so far.
    """
    motions, pitch = run.motions, run.parameters.pitch
    low, high = float(motions.x1.min()) - _ROOM, float(motions.x2.max()) + _ROOM
    travel = float(np.ptp(motions.x1))
    draw_pipe(axes, pitch, low, high)
    drawing = RobotDrawing(axes, run.parameters, run.gait.direction)
    width = high - low - max(travel - _MOST_TRAVEL, 0.0)
    prepare_axes(axes, low, low + width)
    explain_colours(axes.figure, loc="upper right")
    front = motions.front_anchor[0]
    progress = (run.time - run.time[0]) / (run.time[-1] - run.time[0])
    shift = (high - low - width) * (progress if run.gait.direction > 0 else 1.0 - progress)

    def show(index: int) -> None:
        drawing.show(pose_at(motions, run.command, run.parameters, index))
        axes.set_xlim(MM * (low + shift[index]), MM * (low + shift[index] + width))
        grooves = (motions.rear_anchor[index], motions.front_anchor[index] - front)
        rear, ahead = (round(position / pitch) for position in grooves)
        advanced.set_text(
            f"{run.time[index]:5.2f} s   rear fins {rear:+d}, front fins {ahead:+d} grooves"
        )

    return show
