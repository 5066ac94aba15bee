# SPDX-License-Identifier: Apache-2.0
"""Hash of the code that a process runs, so that two versions never compute parts of one study."""

from __future__ import annotations

import hashlib
import inspect
from functools import cache
from importlib.metadata import version
from pathlib import Path

import worm_model
from worm_msgs.robot_parameters import RobotParameters

_NUMERIC = ("numpy", "scipy", "numba")  # their versions may change the last digits of results
_MODEL, _OPTIMIZER = Path(worm_model.__file__).parent, Path(__file__).parent
_MESSAGES = Path(inspect.getfile(RobotParameters)).parent
# All sources, without the generated messages
_SOURCES = {_MODEL: "**/*.py", _OPTIMIZER: "**/*.py", _MESSAGES: "*.py"}
#: packages on which a result depends
PACKAGES = (*_NUMERIC, "worm_model", "worm_optimizer", "xarray", "distributed")


@cache
def code_identity() -> str:
    """Return a hash of all sources, as they are at the first call, with the versions of the numerical packages.

    It must be equal on all workers of a study.
    """
    digest = hashlib.sha256()
    for folder, pattern in _SOURCES.items():
        for path in sorted(folder.glob(pattern)):
            digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return " ".join([digest.hexdigest()[:24], *(f"{name}-{version(name)}" for name in _NUMERIC)])
