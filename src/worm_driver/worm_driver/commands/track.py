# SPDX-License-Identifier: Apache-2.0
"""Command ``track``: measure module positions in a video or a folder of images, without ROS.

The table has one row per image: time_s, rear_position_m, front_position_m, length_m and reason (for NaN).
"""

import argparse
import csv
import math
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path

from worm_driver.commands.driver_command import new_file, run_command, say
from worm_driver.tracking.image_sources import Frame, check_size, frames_of_folder, frames_of_video
from worm_driver.tracking.tracker import TrackedPositions, Tracker
from worm_driver.tracking.tracker_setup import load_setup
from worm_driver.tracking.vision import MarkerDetector
from worm_msgs.command_parser import Parser

COLUMNS = ("time_s", "rear_position_m", "front_position_m", "length_m", "reason")
_PROGRESS_INTERVAL = 300  # images between two lines of progress


def follow(tracker: Tracker, frames: Iterable[Frame]) -> Iterator[TrackedPositions]:
    """Yield the positions of each image. Print events and progress on standard error."""
    detector = MarkerDetector(tracker.setup.dictionary)
    for index, frame in enumerate(frames, 1):
        check_size(frame.image, tracker.camera.size, frame.name)
        sample = tracker.see(detector.detect(frame.image), frame.time)
        if sample.event:
            say(f"track: {frame.time:.3f} s: {sample.event}")
        if index % _PROGRESS_INTERVAL == 0:
            say(f"track: {index} images, {frame.time:.1f} s")
        yield sample


def write_table(path: Path, samples: Iterable[TrackedPositions]) -> list[TrackedPositions]:
    """Write the table and return the samples. Write row by row, so that a cancelled command leaves complete rows."""
    kept = []
    iterator = iter(samples)
    first = list(islice(iterator, 1))  # before the file exists, because images may be missing
    with path.open("x", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for s in chain(first, iterator):
            numbers = [f"{value:.6f}" for value in (s.time, s.rear, s.front, s.length)]
            writer.writerow([*numbers, s.reason])
            kept.append(s)
    return kept


def _parser() -> Parser:
    parser = Parser(prog="track", description=__doc__)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--images",
        type=Path,
        metavar="FOLDER",
        help="folder of images, in the order of its times.csv, or sorted by name without this file",
    )
    source.add_argument("--video", type=Path, metavar="FILE", help="video")
    parser.add_argument(
        "--setup", type=Path, required=True, metavar="FILE", help="setup file of the rig (YAML)"
    )
    parser.add_argument(
        "--output",
        type=new_file,
        required=True,
        metavar="FILE.csv",
        help="CSV table to write",
    )
    return parser


def _run(options: argparse.Namespace) -> None:
    tracker = Tracker(load_setup(options.setup))
    if options.images is not None:
        frames = frames_of_folder(options.images, tracker.setup.rate)
    else:
        frames = frames_of_video(options.video, tracker.setup.rate)
    _report(write_table(options.output, follow(tracker, frames)), options.output)


def _report(samples: list[TrackedPositions], output: Path) -> None:
    complete = sum(math.isfinite(s.length) for s in samples)
    poses = [s.pose for s in samples if s.pose is not None]
    fit = f"; reference markers fit within {poses[-1].error:.2f} px" if poses else ""
    sys.stdout.write(f"{output}: both modules in {complete} of {len(samples)} images{fit}\n")
    reasons = Counter(s.reason for s in samples if s.reason)
    for reason, count in reasons.most_common(3):
        sys.stdout.write(f"  {count}: {reason}\n")


def main(arguments: list[str] | None = None) -> int:
    """Run the command and return the exit status."""
    return run_command(_parser(), _run, arguments)
