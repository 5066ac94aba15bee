# SPDX-License-Identifier: Apache-2.0
"""The command ``calibrate_camera``: a camera's intrinsics from images of the printed board, as a camera_info file."""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from worm_driver.commands.driver_command import Parser, new_file, positive, run_command, say
from worm_driver.commands.markers import BOARD
from worm_driver.tracking.camera_model import Array, camera_info_text
from worm_driver.tracking.image_sources import frames_of_folder
from worm_driver.tracking.tracking_errors import ImageError
from worm_driver.tracking.vision import Board, Calibration, Film, Image, calibrate

FEWEST_VIEWS = 8
_MOST_VIEWS = 60
_FEWEST_CORNERS = 12
_MOVED = 25.0  # pixels; a film's images in which the board has moved less tell nothing new
_GOOD = 0.6  # pixels rms; a flat board and sharp images stay well below
_BAD = 2.0  # pixels rms
_COVERED = 0.5  # of the image's width and height that the corners should reach over

View = tuple[Array, Array]


def find_views(images: Iterator[Image], board: Board) -> tuple[list[View], tuple[int, int]]:
    """Views of the board that differ, and the images' size (width, height).

    Raises ImageError: the images differ in size.
    """
    views: list[View] = []
    size: tuple[int, int] | None = None
    for index, image in enumerate(images):
        height, width = image.shape
        size = size or (width, height)
        if size != (width, height):
            raise ImageError(
                f"image {index} has {width} x {height} pixels, the first one {size[0]} x {size[1]}"
            )
        view = board.find(image)
        if len(view[1]) >= _FEWEST_CORNERS and _is_new(view, views):
            views.append(view)
            say(f"calibrate_camera: view {len(views)}: {len(view[1])} corners")
        if len(views) == _MOST_VIEWS:
            break
    return views, size or (0, 0)


def _is_new(view: View, views: list[View]) -> bool:
    """Whether the board has moved since the last view."""
    if not views:
        return True
    before = {tuple(place): corner for place, corner in zip(*views[-1], strict=True)}
    moves = [
        np.hypot(*(c - before[tuple(p)])) for p, c in zip(*view, strict=True) if tuple(p) in before
    ]
    return not moves or float(np.mean(moves)) > _MOVED


def judged(calibration: Calibration, views: list[View], size: tuple[int, int]) -> list[str]:
    """What is doubtful about a calibration, in sentences; empty if nothing is."""
    doubts = []
    if calibration.error > _GOOD:
        worst = int(np.argmax(calibration.view_errors)) + 1
        doubts.append(
            f"the corners fit within {calibration.error:.2f} px only (view {worst} worst): is the board flat, "
            "are the images sharp, is --square-m what you measure on the print?"
        )
    corners = np.concatenate([view_corners for _, view_corners in views])
    reach = np.ptp(corners, axis=0) / np.array(size)
    if reach.min() < _COVERED:
        doubts.append(
            f"the board was seen over {reach[0]:.0%} of the width and {reach[1]:.0%} of the height only: the lens is "
            "not known beyond; hold it into the corners, too"
        )
    deviation = calibration.focal_deviation / calibration.camera.focal[0]
    if deviation > 0.005:
        doubts.append(
            f"the focal length is known to {deviation:.1%} only: tilt the board by 30 degrees in all directions"
        )
    return doubts


def _images(options: argparse.Namespace) -> Iterator[Image]:
    if options.images is not None:
        # A board's images need no times: any rate will do.
        yield from (frame.image for frame in frames_of_folder(options.images, 1.0))
        return
    film = Film(options.video)
    try:
        while (taken := film.read()) is not None:
            yield taken[0]
    finally:
        film.close()


def _parser() -> Parser:
    parser = Parser(prog="calibrate_camera", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--images", type=Path, metavar="FOLDER", help="images of the board")
    source.add_argument(
        "--video",
        metavar="FILE",
        help=f"a film of the board, or a camera such as /dev/video0, until {_MOST_VIEWS} views differ",
    )
    parser.add_argument("--output", type=new_file, required=True, metavar="FILE.yaml")
    parser.add_argument(
        "--square-m",
        type=positive,
        default=BOARD[2],
        metavar="M",
        help=f"side of a square as measured on the print (default {BOARD[2]})",
    )
    parser.add_argument(
        "--model",
        choices=("plumb_bob", "rational_polynomial"),
        default="plumb_bob",
        help="rational_polynomial for wide lenses",
    )
    parser.add_argument("--name", default="camera", help="of the camera, in the file")
    return parser


def _run(options: argparse.Namespace) -> None:
    columns, rows, _, dictionary = BOARD
    views, size = find_views(_images(options), Board(columns, rows, options.square_m, dictionary))
    if len(views) < FEWEST_VIEWS:
        raise ImageError(
            f"the board was found in {len(views)} images that differ, {FEWEST_VIEWS} are needed: hold it still, near "
            "and far, tilted, and into all corners of the image (markers --board prints it)"
        )
    calibration = calibrate(views, size, options.model)
    if not calibration.error < _BAD:
        raise ImageError(
            f"no camera fits: the corners lie {calibration.error:.1f} px beside: is the board flat and printed whole?"
        )
    with options.output.open("x", encoding="utf-8") as stream:
        stream.write(camera_info_text(options.name, calibration.camera))
    for doubt in judged(calibration, views, size):
        say(f"calibrate_camera: {doubt}")
    fx, fy = calibration.camera.focal
    sys.stdout.write(
        f"{options.output}: {len(views)} views, reprojection error {calibration.error:.3f} px, "
        f"focal length {fx:.1f} and {fy:.1f} px, known to {calibration.focal_deviation:.1f} px\n"
    )


def main(arguments: list[str] | None = None) -> int:
    """The command; returns the exit status."""
    return run_command(_parser(), _run, arguments)
