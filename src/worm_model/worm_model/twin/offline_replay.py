# SPDX-License-Identifier: Apache-2.0
"""A recording through the twin, offline: arrays in, arrays out, the same each time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.records import Event, Health, residual_message
from worm_model.twin.samples import Received, rows_of_run
from worm_model.twin.twin import Twin

Series = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Replay:
    """What the twin made of a recording: each series is a column per field of its record, by name.

    Attributes:
        states: of StateRecord (the message TwinState).
        residuals: of ResidualRecord (TwinResiduals), `messages` apart, with the channels' sizes and levels.
        lengths: `stamp_ns`, `length`, `length_change` (BodyLength, ESTIMATED).
        notices: what the twin told on the way (TwinEvent).
        warnings: texts that residuals refer to by number.
        dropped: how many samples were not taken, by why.
    """

    states: Series
    residuals: Series
    lengths: Series
    notices: tuple[Event, ...] = ()
    warnings: dict[int, str] | None = None
    dropped: dict[str, int] | None = None

    @cached_property
    def messages(self) -> tuple[str, ...]:
        """The residuals' messages."""
        series = self.residuals
        texts = [""] * len(series["stamp_ns"])
        for row in np.flatnonzero(series["health"] > Health.HEALTHY).tolist():
            line = {name: column[row] for name, column in series.items()}
            texts[row] = residual_message(line, self.warnings or {})
        return tuple(texts)


def replay_run(run: Run, parameters: Parameters, received: Received | None = None) -> Replay:
    """Let the twin follow a recording; ``received`` as `rows_of_run` takes it."""
    twin = Twin(parameters)
    state = twin.start()
    rows = rows_of_run(run, round(twin.settings.jump_back_s * 1e9), received)
    output = twin.advance(state, rows, to_the_end=True)
    return Replay(
        states=_columns(output.states),
        residuals=_columns(output.residuals),
        lengths=_columns(output.lengths),
        notices=output.events,
        warnings=output.warnings,
        dropped={name: n for name, n in state.counts.items() if n and name != "taken"},
    )


def _columns(rows: np.ndarray) -> Series:
    assert rows.dtype.names is not None
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
