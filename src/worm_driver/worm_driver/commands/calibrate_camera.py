# SPDX-License-Identifier: Apache-2.0
"""Command ``calibrate_camera``: write camera_info from images of the printed board."""

import argparse
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from worm_driver.commands.driver_command import new_file, positive, run_command, say
from worm_driver.commands.markers import BOARD
from worm_driver.driver_errors import ImageError
from worm_driver.tracking.camera_model import Array, camera_info_text
from worm_driver.tracking.image_sources import frames_of_folder
from worm_driver.tracking.vision import Board, Calibration, Image, VideoSource, calibrate
from worm_msgs.command_parser import Parser

FEWEST_VIEWS = 8  # smallest number of views of the board
_MOST_VIEWS = 60  # number of views after which no further image is read
_FEWEST_CORNERS = 12  # smallest number of the board's corners in a view
_MOVED = 25.0  # pixels, smallest motion of the board since the last view; less motion adds no information
_GOOD = 0.6  # pixels rms, reprojection error above which a warning follows; sharp images of a flat board have less
_BAD = 2.0  # pixels rms, reprojection error from which on the calibration is rejected
_COVERED = 0.5  # smallest share of the image's width and height that the corners should span

View = tuple[Array, Array]


def find_views(images: Iterator[Image], board: Board) -> tuple[list[View], tuple[int, int]]:
    """Return views of the board that differ, and the image size (width, height), pixels."""
    views: list[View] = []
    size: tuple[int, int] | None = None
    for index, image in enumerate(images):
        height, width = image.shape
        size = size or (width, height)
        if size != (width, height):
            raise ImageError(
                f"image {index} has {width} x {height} pixels, the first image {size[0]} x {size[1]}"
            )
        view = board.find(image)
        if len(view[1]) >= _FEWEST_CORNERS and _is_new(view, views):
            views.append(view)
            say(f"calibrate_camera: view {len(views)}: {len(view[1])} corners")
        if len(views) == _MOST_VIEWS:
            break
    return views, size or (0, 0)


def _is_new(view: View, views: list[View]) -> bool:
    """Return True if the board has moved since the last view."""
    if not views:
        return True
    before = {tuple(place): corner for place, corner in zip(*views[-1], strict=True)}
    moves = [
        np.hypot(*(c - before[tuple(p)])) for p, c in zip(*view, strict=True) if tuple(p) in before
    ]
    return not moves or float(np.mean(moves)) > _MOVED


def warnings_of(calibration: Calibration, views: list[View], size: tuple[int, int]) -> list[str]:
    """Return warnings about a calibration; empty if there are none."""
    warnings = []
    if calibration.error > _GOOD:
        worst = int(np.argmax(calibration.view_errors)) + 1
        warnings.append(
            f"the reprojection error is {calibration.error:.2f} px (view {worst} is worst). Check that the board is "
            "flat, the images are sharp and --square-m is the side of a square measured on the print"
        )
    corners = np.concatenate([view_corners for _, view_corners in views])
    reach = np.ptp(corners, axis=0) / np.array(size)
    if reach.min() < _COVERED:
        warnings.append(
            f"the board covers only {reach[0]:.0%} of the width and {reach[1]:.0%} of the height. Elsewhere in "
            "the image, the lens model is extrapolated: add views with the board in the corners"
        )
    deviation = calibration.focal_deviation / calibration.camera.focal[0]
    if deviation > 0.005:
        warnings.append(
            f"the focal length has an uncertainty of {deviation:.1%}: add views with the board tilted by 30 degrees"
        )
    return warnings


def _images(options: argparse.Namespace) -> Iterator[Image]:
    if options.images is not None:
        # The times of the images are not used, so the rate does not matter.
        yield from (frame.image for frame in frames_of_folder(options.images, 1.0))
        return
    with closing(VideoSource(options.video)) as video:
        yield from (image for image, _ in video.images())


def _parser() -> Parser:
    parser = Parser(prog="calibrate_camera", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--images", type=Path, metavar="FOLDER", help="images of the board")
    source.add_argument(
        "--video",
        metavar="FILE",
        help="a video of the board, or a camera such as /dev/video0; reading ends after "
        f"{_MOST_VIEWS} views, each moved from the one before",
    )
    parser.add_argument("--output", type=new_file, required=True, metavar="FILE.yaml")
    parser.add_argument(
        "--square-m",
        type=positive,
        default=BOARD[2],
        metavar="M",
        help=f"side of a square as measured on the print (default {BOARD[2]})",
    )
    return parser


def _run(options: argparse.Namespace) -> None:
    columns, rows, _, dictionary = BOARD
    views, size = find_views(_images(options), Board(columns, rows, options.square_m, dictionary))
    if len(views) < FEWEST_VIEWS:
        raise ImageError(
            f"the board was found in {len(views)} different images; at least {FEWEST_VIEWS} are needed. Hold it still, "
            "near and far, tilted, and in all corners of the image (markers --board prints it)"
        )
    calibration = calibrate(views, size)
    if not calibration.error < _BAD:
        raise ImageError(
            f"the lens model plumb_bob does not fit: the reprojection error is {calibration.error:.1f} px. Check that "
            "the board is flat and printed completely, and that the lens is no wide-angle lens"
        )
    with options.output.open("x", encoding="utf-8") as stream:
        stream.write(camera_info_text(calibration.camera))
    for warning in warnings_of(calibration, views, size):
        say(f"calibrate_camera: {warning}")
    fx, fy = calibration.camera.focal
    sys.stdout.write(
        f"{options.output}: {len(views)} views, reprojection error {calibration.error:.3f} px, "
        f"focal length {fx:.1f} and {fy:.1f} px, uncertainty {calibration.focal_deviation:.1f} px\n"
    )


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)
