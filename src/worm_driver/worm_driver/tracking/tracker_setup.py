# SPDX-License-Identifier: Apache-2.0
"""Setup file of the tracker: markers, their positions and the camera, validated before any image is read.

The pipe's frame is that of REP 103: x forward along the axis, y to the left, z up.
"""

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from worm_driver.tracking.camera_model import CameraModel, load_camera_info
from worm_driver.tracking.tracking_errors import SetupError

#: Marker dictionaries (OpenCV names) with their numbers of markers.
DICTIONARIES = {
    **{f"DICT_{n}X{n}_{count}": count for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
#: A single marker determines the camera's direction to one or two degrees only, about a centimetre at the modules.
FEWEST_REFERENCES = 2
#: Largest marker side or offset, distance from the pipe's axis, and distance along it (m). Larger values are
#: probably in mm.
LARGEST_MARKER, LARGEST_SIDEWAYS, LARGEST_ALONG = 0.5, 3.0, 20.0

_REQUIRED = (
    *("dictionary", "marker_size_m", "rear", "front"),
    *("module_line", "reference", "camera_info"),
)
_OPTIONAL = {"rate_hz": 0.0, "delay_s": 0.0, "pose": "fixed", "max_speed_m_s": 0.5}
POSES = ("fixed", "each_image")


@dataclass(frozen=True)
class ModuleMarker:
    """Marker on a module. offset: distance along x from the marker's centre to the fin root, m."""

    number: int
    offset: float


@dataclass(frozen=True)
class TrackerSetup:
    """Validated setup of a tracker rig.

    Attributes:
        dictionary: a key of DICTIONARIES.
        marker_size: side of the black square, m.
        rear, front: markers of the modules.
        line: (y, z) of the line along which the markers' centres move, m.
        reference: centre (x, y, z) of each marker fixed to the pipe, m, by marker number.
        camera: calibration; None if it comes with the images (camera_info: topic).
        rate: rate of images without times, Hz; 0 if not given.
        delay: delay from exposure to stamp, s.
        pose: one of POSES.
        max_speed: largest speed of a module, m/s; faster detections are rejected.
    """

    dictionary: str
    marker_size: float
    rear: ModuleMarker
    front: ModuleMarker
    line: tuple[float, float]
    reference: Mapping[int, tuple[float, float, float]]
    camera: CameraModel | None
    rate: float = 0.0
    delay: float = 0.0
    pose: str = "fixed"
    max_speed: float = 0.5

    @property
    def origin(self) -> float:
        """Position x of the first reference marker (m), the zero of all positions."""
        return next(iter(self.reference.values()))[0]


class _Loader(yaml.SafeLoader):
    """YAML loader that rejects duplicate keys, of which PyYAML would silently drop the first."""


def _unique_mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    before = []
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if key in before:
            raise SetupError(f"line {key_node.start_mark.line + 1}: duplicate key {key}")
        before.append(key)
    return yaml.SafeLoader.construct_mapping(loader, node, deep=True)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def load_setup(path: Path) -> TrackerSetup:
    """Read a setup file and the calibration that it names.

    Raises:
        SetupError: The file is missing or invalid. The message names the key and the problem.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except OSError as error:
        raise SetupError(f"{path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise SetupError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from None
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from None
    try:
        return _setup(content, path.parent)
    except SetupError as error:
        raise SetupError(f"{path}: {error}") from None


def _setup(content: Any, folder: Path) -> TrackerSetup:
    keys = _keys(content, "the file", _REQUIRED, _OPTIONAL)
    size = _length(keys["marker_size_m"], "marker_size_m", LARGEST_MARKER)
    if size <= 0.0:
        raise SetupError(f"marker_size_m must be above 0, not {size:g}")
    dictionary = keys["dictionary"]
    if dictionary not in DICTIONARIES:
        raise SetupError(f"unknown dictionary {dictionary!r}; use one of {', '.join(DICTIONARIES)}")
    line = _keys(keys["module_line"], "module_line", ("y_m", "z_m"), {})
    rear, front = (_module(keys[name], name) for name in ("rear", "front"))
    reference = _reference(keys["reference"])
    _check_numbers(dictionary, rear, front, reference)
    _check_places(size, reference)
    return TrackerSetup(
        dictionary,
        size,
        rear,
        front,
        (
            _length(line["y_m"], "module_line: y_m", LARGEST_SIDEWAYS),
            _length(line["z_m"], "module_line: z_m", LARGEST_SIDEWAYS),
        ),
        reference,
        _camera(keys["camera_info"], folder),
        _not_negative(keys["rate_hz"], "rate_hz"),
        _not_negative(keys["delay_s"], "delay_s"),
        _choice(keys["pose"], "pose", POSES),
        _positive(keys["max_speed_m_s"], "max_speed_m_s"),
    )


def _keys(
    content: Any, place: str, required: tuple[str, ...], optional: Mapping[str, Any]
) -> dict[str, Any]:
    if not isinstance(content, Mapping):
        raise SetupError(f"{place} must be a mapping with {', '.join(required)}")
    known = [*required, *optional]
    unknown = [key for key in content if key not in known]
    if unknown:
        raise SetupError(f"{place}: unknown key {unknown[0]!r}; the keys are {', '.join(known)}")
    missing = [key for key in required if key not in content]
    if missing:
        hint = " (the camera's calibration, see calibrate_camera)" * (missing[0] == "camera_info")
        raise SetupError(f"{place}: {missing[0]}{hint} is missing")
    return {**optional, **content}


def _module(content: Any, name: str) -> ModuleMarker:
    keys = _keys(content, name, ("id",), {"offset_m": 0.0})
    return ModuleMarker(
        _marker_number(keys["id"], f"{name}: id"),
        _length(keys["offset_m"], f"{name}: offset_m", LARGEST_MARKER),
    )


def _reference(content: Any) -> dict[int, tuple[float, float, float]]:
    if not isinstance(content, Mapping):
        raise SetupError("reference must map each marker's number to its [x, y, z] in m")
    places: dict[int, tuple[float, float, float]] = {}
    for key, place in content.items():
        number = _marker_number(key, "reference")
        if not isinstance(place, list) or len(place) != 3:
            raise SetupError(f"reference: {number} must be [x, y, z] in m, not {place!r}")
        places[number] = (
            _length(place[0], f"reference: {number}: x", LARGEST_ALONG),
            _length(place[1], f"reference: {number}: y", LARGEST_SIDEWAYS),
            _length(place[2], f"reference: {number}: z", LARGEST_SIDEWAYS),
        )
    if len(places) < FEWEST_REFERENCES:
        raise SetupError(
            f"reference: {FEWEST_REFERENCES} markers are needed, not {len(places)}: a single "
            "marker does not determine the camera's direction, and camera motion could not be detected"
        )
    return places


def _check_numbers(
    dictionary: str,
    rear: ModuleMarker,
    front: ModuleMarker,
    reference: Mapping[int, tuple[float, float, float]],
) -> None:
    if rear.number == front.number:
        raise SetupError(f"rear and front have the same marker {rear.number}: give each its own")
    for name, module in (("rear", rear), ("front", front)):
        if module.number in reference:
            raise SetupError(
                f"marker {module.number} is both {name} and a reference: give each its own"
            )
    count = DICTIONARIES[dictionary]
    for number in (rear.number, front.number, *reference):
        if number >= count:
            raise SetupError(f"marker {number}: {dictionary} has 0 to {count - 1}")


def _check_places(size: float, reference: Mapping[int, tuple[float, float, float]]) -> None:
    """Raise SetupError if two markers overlap, which also happens if their positions are not in m."""
    items = list(reference.items())
    for index, (number, place) in enumerate(items):
        for other, other_place in items[:index]:
            if math.dist(place, other_place) < size:
                raise SetupError(
                    f"reference: {other} and {number} are {math.dist(place, other_place):g} m apart, closer than the "
                    f"{size:g} m width of a marker. Are the positions in m?"
                )


def _camera(content: Any, folder: Path) -> CameraModel | None:
    if not isinstance(content, str) or not content:
        raise SetupError("camera_info must be the name of a file, or topic")
    return None if content == "topic" else load_camera_info(folder / content)


def _marker_number(value: Any, place: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise SetupError(
            f"{place}: a marker number must be an integer of at least 0, not {value!r}"
        )
    return value


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise SetupError(f"{place} must be a number, not {value!r}")
    return float(value)


def _length(value: Any, place: str, largest: float) -> float:
    length = _number(value, place)
    if abs(length) > largest:
        raise SetupError(
            f"{place} is {length:g} m: lengths are in m, not mm (did you mean {length / 1000:g}?)"
        )
    return length


def _positive(value: Any, place: str) -> float:
    number = _number(value, place)
    if number <= 0.0:
        raise SetupError(f"{place} must be above 0, not {number:g}")
    return number


def _not_negative(value: Any, place: str) -> float:
    number = _number(value, place)
    if number < 0.0:
        raise SetupError(f"{place} must not be negative, not {number:g}")
    return number


def _choice(value: Any, place: str, choices: tuple[str, ...]) -> str:
    if value not in choices:
        raise SetupError(f"{place} must be one of {', '.join(choices)}, not {value!r}")
    return str(value)
