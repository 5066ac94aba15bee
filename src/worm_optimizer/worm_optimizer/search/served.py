# SPDX-License-Identifier: Apache-2.0
"""The front that requests are answered from, as one value that can be written down."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from worm_optimizer.robustness.prediction import Prediction


@dataclass(frozen=True)
class ServedFront:
    """A front with everything that is told about its gaits, by rising speed, and where it comes from.

    ``margin`` in m with the ``reason`` for it; ``source``, ``hypervolume_share`` and ``missed_branches``
    as in `certificate.CertifiedFront`, for the whole front of which some gaits are kept here.
    """

    direction: int
    margin: float
    reason: str
    source: str
    hypervolume_share: float
    missed_branches: tuple[int, ...]
    predictions: tuple[Prediction, ...]

    def mirrored(self) -> ServedFront:
        """The same front in the other direction, for a robot with equal modules: its exact mirror image."""
        predictions = tuple(
            dataclasses.replace(gait, direction=-gait.direction) for gait in self.predictions
        )
        return dataclasses.replace(self, direction=-self.direction, predictions=predictions)

    def as_dict(self) -> dict[str, Any]:
        """The front as plain values, for a file."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(content: Mapping[str, Any]) -> ServedFront:
        """The inverse of `as_dict`; raises TypeError, KeyError or ValueError on anything else."""
        values = dict(content)
        values["missed_branches"] = tuple(int(n) for n in values["missed_branches"])
        values["predictions"] = tuple(Prediction(**row) for row in values["predictions"])
        return ServedFront(**values)
