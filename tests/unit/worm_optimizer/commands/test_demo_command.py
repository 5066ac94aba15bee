# SPDX-License-Identifier: Apache-2.0
"""The table of the demo about its run."""

import math
from types import SimpleNamespace

import pytest

from worm_model.errors import RecordingError
from worm_optimizer.commands.demo import compare
from worm_optimizer.report.expectation import Band, Bands


def test_a_missing_number_is_rejected_of_the_twin_too():
    seen, nothing = Band(1.0, 1.0, 1.0), Band(math.nan, math.nan, math.nan)
    gait = SimpleNamespace(early_end="", missing=(), twin=Bands(seen, nothing, nothing))
    with pytest.raises(RecordingError, match="the twin did not follow"):
        compare(gait, None)
