# SPDX-License-Identifier: Apache-2.0
"""Study that is computed in a second, for tests, and a substitute for its workers."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from worm_model.parameters import ParameterFile
from worm_msgs.settings_file import settings_of
from worm_optimizer.study.study_file import Study, StudyFile

SMALL = """\
title: small
vary:
  slack: [0.004, 0.008, 0.012]
  switching_threshold: [0.008, 0.0175]     # 8 mm is less than half the pitch: not admissible
fixed: {margin_m: 0.002, at_power_W: 2.6}
compute: [front, gaits]
resolution: {strokes: 9, frequencies: 5, front_gaits: 4, samples: 10}
"""


def changed(**changes: object) -> str:
    """Return the small study with some keys changed; None removes one."""
    content = {**yaml.safe_load(SMALL), **changes}
    return yaml.safe_dump({key: value for key, value in content.items() if value is not None})


def small_study(**changes: object) -> Study:
    """Return the small study of the paper's robot with some keys changed; None removes one."""
    text = changed(**changes) if changes else SMALL
    file = settings_of(yaml.safe_load(text), StudyFile)
    return Study(file, text, (("the paper", ParameterFile()),))


class Here:
    """Computation in this process, in place of workers; ``pieces`` is the number of blocks so far."""

    def __init__(self) -> None:
        self.pieces = 0
        self.most = 1_000_000

    def __call__(
        self, compute: Any, pieces: Mapping[Path, Any], workers: Any, say: Any
    ) -> Iterator[Any]:
        """Yield the blocks; raise KeyboardInterrupt after ``most`` blocks."""
        for file, piece in pieces.items():
            if self.pieces >= self.most:
                raise KeyboardInterrupt
            self.pieces += 1
            yield file, compute(piece)
