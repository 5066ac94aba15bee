# SPDX-License-Identifier: Apache-2.0
"""Rows of ``worm check`` on the tracker's camera: its rate, its delay, and the markers that it sees."""

import contextlib
import statistics
import time
from functools import partial
from itertools import islice, pairwise

from worm_driver.control.bench_check import CAMERA_ROWS, AdviceError, Row, fail, judge, skipped
from worm_driver.control.diagnostics import Level
from worm_driver.driver_errors import ImageError, TrackingError
from worm_driver.tracking.image_sources import check_size
from worm_driver.tracking.tracker import Tracker, TrackerReport
from worm_driver.tracking.vision import Image, MarkerDetector, VideoSource

_IMAGES = 30
#: Longest plausible delay of an image, s. A longer one shows that the camera stamps by another clock.
_LONGEST_DELAY = 2.0
#: Ratio of the measured to the requested rate below which the camera is too slow.
_SLOW = 0.9

#: Image, its time of exposure according to the camera, and its arrival, s, monotonic.
Shot = tuple[Image, float, float]


def camera_rows(tracker: Tracker, source: str) -> list[Row]:
    """Return the rows on a V4L2 camera, from images that are read now."""
    try:
        shots = _shots(tracker, source)
    except TrackingError as error:
        return [
            judge(CAMERA_ROWS[0], [partial(fail, error)]),
            *skipped(CAMERA_ROWS[1:], "no usable images"),
        ]
    return [
        judge(name, [partial(check, tracker, shots)])
        for name, check in zip(CAMERA_ROWS, (_rate, _delay, _markers), strict=True)
    ]


def _shots(tracker: Tracker, source: str) -> list[Shot]:
    shots: list[Shot] = []
    with contextlib.closing(VideoSource(source)) as camera:
        camera.request_format(*tracker.camera.size, tracker.setup.rate)
        # The first image waits for the start of the camera.
        for image, exposed in islice(camera.images(), 1, 1 + _IMAGES):
            shots.append((image, exposed, time.monotonic()))
    if len(shots) < _IMAGES:
        raise ImageError(f"{source} delivers no more images: was it unplugged?")
    check_size(shots[0][0], tracker.camera.size, source)
    return shots


def _period(shots: list[Shot]) -> float:
    return statistics.median(b - a for (_, _, a), (_, _, b) in pairwise(shots))


def _rate(tracker: Tracker, shots: list[Shot]) -> str:
    rate = 1.0 / _period(shots)
    if rate < _SLOW * tracker.setup.rate:
        raise AdviceError(
            f"{rate:.1f} Hz instead of rate_hz {tracker.setup.rate:g}: give the camera more light (a long exposure "
            "slows it), or a port without other cameras, or lower rate_hz in the setup file"
        )
    return f"{rate:.1f} Hz"


def _delay(tracker: Tracker, shots: list[Shot]) -> str:
    delay = statistics.median(arrival - exposed for _, exposed, arrival in shots)
    if not 0.0 <= delay <= _LONGEST_DELAY:
        return "not measured: the camera does not stamp its images by the clock of the computer"
    if abs(delay - tracker.setup.delay) > 0.5 * _period(shots):
        raise AdviceError(
            f"{delay * 1e3:.0f} ms from exposure to arrival, but delay_s is {tracker.setup.delay:g}: set delay_s in "
            f"the setup file to {delay:.3f}"
        )
    return f"{delay * 1e3:.0f} ms from exposure to arrival"


def _markers(tracker: Tracker, shots: list[Shot]) -> str:
    detector, report = MarkerDetector(tracker.setup.dictionary), TrackerReport("camera")
    for image, _, arrival in shots:
        report.count(tracker.see(detector.detect(image), arrival))
    result = report.next_report()
    if result.level is not Level.OK:
        raise AdviceError(
            f"{result.message}: free the view, and check the light and the setup file"
        )
    return f"both modules and the reference markers; {result.values[-1][1]} px"
