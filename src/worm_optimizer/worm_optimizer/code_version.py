# SPDX-License-Identifier: Apache-2.0
"""Hash of the code that a process runs, so that two versions never compute parts of one study."""

from __future__ import annotations

import hashlib
import inspect
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import worm_model
from worm_msgs.robot_parameters import RobotParameters

_NUMERIC = ("numpy", "scipy", "numba")  # their versions may change the last digits of results
_MODEL, _OPTIMIZER = Path(worm_model.__file__).parent, Path(__file__).parent
_MESSAGES = Path(inspect.getfile(RobotParameters)).parent
# Sources that determine the numbers of a study with given values. The readers of YAML files are not among them, because
# a block contains the hash of all values that they returned (`plan.Study.identity`). Patterns of whole folders include
# files that are added later.
_SOURCES: Mapping[Path, tuple[str, ...]] = {
    _MODEL: (
        "arrays.py",
        "errors.py",
        "gait.py",
        "loads.py",
        "parameters.py",
        "travel_error.py",
        "margin/predicted_margin.py",
        "simulation/**/*.py",
    ),
    _OPTIMIZER: (
        "evaluation/*.py",
        "search/*.py",
        "robustness/*.py",
        "study/plan.py",
        "study/point.py",
        "study/study_file.py",
        "gait_prediction.py",
    ),
    _MESSAGES: (
        "conditions.py",
        "driver_file.py",
        "gait.py",
        "robot_parameters.py",
        "ros_parameter_file.py",
        "servo_models.py",
    ),
}
# All sources, without the generated messages
_ALL: Mapping[Path, tuple[str, ...]] = {
    _MODEL: ("**/*.py",),
    _OPTIMIZER: ("**/*.py",),
    _MESSAGES: ("*.py",),
}
_OTHERS = ("worm_model", "worm_optimizer", "xarray", "distributed")


def versions() -> dict[str, str]:
    """Return the versions of Python and packages, by name."""
    versions = {"python": platform.python_version()}
    for name in (*_NUMERIC, *_OTHERS):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:  # The packages run from a checkout.
            versions[name] = "not installed"
    return versions


def sources() -> list[Path]:
    """Return the source files that determine the numbers of a study, in an order independent of their location."""
    return _found(_SOURCES)


def _found(places: Mapping[Path, tuple[str, ...]]) -> list[Path]:
    return [
        path
        for folder, patterns in places.items()
        for path in sorted(path for pattern in patterns for path in folder.glob(pattern))
    ]


def identity() -> str:
    """Return a hash of `sources` with the versions of the numerical packages."""
    return _hash(sources())


@cache
def identity_of_all() -> str:
    """Return a hash as `identity`, but of all sources, as they are at the first call. It must be equal on all workers.

    Use it for results that depend on recordings, because the code of bags, twin and identification also affects them.
    """
    return _hash(_found(_ALL))


def _hash(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return " ".join([digest.hexdigest()[:24], *(f"{name}-{version(name)}" for name in _NUMERIC)])
