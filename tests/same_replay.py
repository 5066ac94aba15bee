# SPDX-License-Identifier: Apache-2.0
"""Holds the twin all at once against the twin sample by sample."""

import numpy as np

from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.by_sample import Replay, replay_samples
from worm_model.twin.offline.follow import replay_columns
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings


def check_same(run: Run, parameters: Parameters, settings: TwinSettings = DEFAULTS) -> Replay:
    """Every state, residual, length, message and notice agrees, numbers to rounding; raises Irregular."""
    one = replay_columns(run, parameters, settings)
    other = replay_samples(run, parameters, settings)
    for part in ("states", "residuals", "lengths"):
        columns, expected = getattr(one, part), getattr(other, part)
        assert columns.keys() == expected.keys()
        for name, values in expected.items():
            where = f"{part}.{name}"
            assert columns[name].dtype == values.dtype, where
            if np.issubdtype(values.dtype, np.integer):
                assert columns[name].tolist() == values.tolist(), where
            else:
                np.testing.assert_allclose(
                    columns[name], values, rtol=1e-9, atol=1e-10, err_msg=where
                )
    assert one.messages == other.messages
    assert one.notices == other.notices
    return one
