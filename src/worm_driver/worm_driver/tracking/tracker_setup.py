# SPDX-License-Identifier: Apache-2.0
"""Setup file of the tracker: markers, their positions and the camera, validated before any image is read.

The pipe's frame is that of REP 103: x forward along the axis, y to the left, z up.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from worm_driver.driver_errors import SetupError
from worm_msgs.parameter_rows import ParameterRow
from worm_msgs.settings_file import OneOf, key, read_settings

#: Value of source that selects the topic of a camera.
TOPIC = "topic"
_PARAMETERS = tuple(
    ParameterRow(name, default, text, read_only=True)
    for name, default, text in (
        ("setup_file", "", "Setup file of the camera and the markers (YAML)."),
        (
            "source",
            TOPIC,
            "Source of the images: topic, or a V4L2 device such as /dev/video0.",
        ),
    )
)
#: Marker dictionaries (OpenCV names) with their numbers of markers.
DICTIONARIES = {
    **{f"DICT_{n}X{n}_{count}": count for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
#: Smallest number of reference markers. A single marker determines the camera's direction only to one or two degrees,
#: which is an error of about a centimetre at the modules.
FEWEST_REFERENCES = 2
#: Largest side or offset of a marker (m). A value above this limit, or above one of the next two limits, is probably in
#: mm.
LARGEST_MARKER = 0.5
#: Largest distance from the pipe's axis along y, and along z (m).
LARGEST_SIDEWAYS = 3.0
#: Largest distance along the pipe's axis (m).
LARGEST_ALONG = 20.0


def rows() -> tuple[ParameterRow, ...]:
    """Return the parameters of the tracker's node."""
    return _PARAMETERS


MarkerNumber = Annotated[int, key(ge=0)]
Along = Annotated[float, key(ge=-LARGEST_ALONG, le=LARGEST_ALONG)]
Sideways = Annotated[float, key(ge=-LARGEST_SIDEWAYS, le=LARGEST_SIDEWAYS)]
Place = tuple[Along, Sideways, Sideways]


@dataclass(frozen=True)
class ModuleMarker:
    """Marker on a module. offset: x of the fin root minus x of the marker's centre, m."""

    number: Annotated[int, key("id", ge=0)]
    offset: Annotated[float, key("offset_m", ge=-LARGEST_MARKER, le=LARGEST_MARKER)] = 0.0


@dataclass(frozen=True)
class ModuleLine:
    """Line along which the centres of the modules' markers move, m."""

    y: Annotated[float, key("y_m", ge=-LARGEST_SIDEWAYS, le=LARGEST_SIDEWAYS)]
    z: Annotated[float, key("z_m", ge=-LARGEST_SIDEWAYS, le=LARGEST_SIDEWAYS)]


@dataclass(frozen=True, kw_only=True)
class TrackerSetup:
    """Setup of a tracker: markers, their positions and the camera.

    Attributes:
        dictionary: a key of DICTIONARIES.
        marker_size: side of the black square, m.
        rear, front: markers of the modules.
        line: line along which the centres of the modules' markers move.
        reference: centre (x, y, z) of each marker fixed to the pipe, m, by marker number.
        camera_info: path of the calibration file, in a setup file relative to it.
        rate: frame rate, Hz, assumed for images without timestamps and requested from a camera; 0 if not given.
        delay: delay from exposure to stamp, s.
    """

    dictionary: Annotated[str, OneOf(tuple(DICTIONARIES))]
    marker_size: Annotated[float, key("marker_size_m", gt=0.0, le=LARGEST_MARKER)]
    rear: ModuleMarker
    front: ModuleMarker
    line: Annotated[ModuleLine, key("module_line")]
    reference: Mapping[MarkerNumber, Place]
    camera_info: Annotated[str, key(min_length=1)]
    rate: Annotated[float, key("rate_hz", ge=0.0)] = 0.0
    delay: Annotated[float, key("delay_s", ge=0.0)] = 0.0

    @property
    def origin(self) -> float:
        """Position x of the first reference marker (m), the zero of all positions."""
        return next(iter(self.reference.values()))[0]


def load_setup(path: Path) -> TrackerSetup:
    """Read a setup file.

    Raises:
        SetupError: The setup file is missing or invalid. The message names the problem.
    """
    setup = read_settings(path, TrackerSetup, SetupError)
    try:
        _check_numbers(setup)
        _check_places(setup)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from None
    return replace(setup, camera_info=str(path.parent / setup.camera_info))


def _check_numbers(setup: TrackerSetup) -> None:
    """Raise SetupError for too few reference markers, or a number that is used twice or not in the dictionary."""
    if len(setup.reference) < FEWEST_REFERENCES:
        raise SetupError(
            f"reference: {FEWEST_REFERENCES} markers are needed, not {len(setup.reference)}: a single "
            "marker does not determine the camera's direction, and camera motion could not be detected"
        )
    used = dict.fromkeys(setup.reference, "a reference")
    for name, module in (("rear", setup.rear), ("front", setup.front)):
        if module.number in used:
            raise SetupError(
                f"marker {module.number} is both {used[module.number]} and {name}: give each its own"
            )
        used[module.number] = name
    count = DICTIONARIES[setup.dictionary]
    for number in used:
        if number >= count:
            raise SetupError(f"marker {number}: {setup.dictionary} has 0 to {count - 1}")


def _check_places(setup: TrackerSetup) -> None:
    """Raise SetupError if the centres of two reference markers are closer than the side of a marker."""
    for (other, other_place), (number, place) in itertools.combinations(setup.reference.items(), 2):
        distance = math.dist(place, other_place)
        if distance < setup.marker_size:
            raise SetupError(
                f"reference: {other} and {number} are {distance:g} m apart, closer than the "
                f"{setup.marker_size:g} m width of a marker. Are the positions in m?"
            )
