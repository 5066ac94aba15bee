# SPDX-License-Identifier: Apache-2.0
"""Studies that are computed in a second, for tests."""

from __future__ import annotations

import hashlib
from pathlib import Path

SMALL = """\
title: small
vary:
  slack: [0.004, 0.008, 0.012]
  switching_threshold: [0.008, 0.0175]     # 8 mm is less than half the pitch: not admissible
fixed: {margin_m: 0.002, at_power_W: 2.6}
compute: [front, gaits]
resolution: {strokes: 9, frequencies: 5, front_gaits: 4, samples: 10}
block_points: 1
"""


def contents(store: Path) -> dict[str, str]:
    """Return the hash of every file of a store, by its name in the store."""
    return {
        str(file.relative_to(store)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(store.rglob("*"))
        if file.is_file()
    }
