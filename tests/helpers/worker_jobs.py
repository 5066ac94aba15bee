# SPDX-License-Identifier: Apache-2.0
"""Jobs for Dask workers, in a module that the workers' processes can import."""

import os
import signal
from pathlib import Path


def suicide(place: int, marker: str) -> int:
    """End the worker at the first call."""
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return place


def reject(place: int) -> int:
    raise ValueError(f"piece {place}")
