# SPDX-License-Identifier: Apache-2.0
"""Cable force of each run without the damping term, and random draws of this force within its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.fits.estimate import Estimate, quantile
from worm_model.identification.fits.locomotion import Traverse
from worm_model.identification.locomotion_stage import LocomotionResult, holding_forces
from worm_model.identification.reference_values import ReferenceValues
from worm_model.parameters import Parameters


@dataclass(frozen=True)
class Forces:
    """Forces F_c + c_b·L̇ = H + k_b(L_free − L) of each run at the times of its length; H as in `fits.energy`.

    Attributes:
        holding: H (N) by fit and run. The first fit is the best one. In each further fit, η or a combination of
            the fin parameters is one standard deviation away from its best value.
        change: ΔL of each run, m.
        initial_length: L0 of each run, m, shape (runs,).
        stiffness, stiffness_deviation: k_b with standard deviation, N/m.
        free_length, free_length_deviation: L_free with standard deviation, m.
    """

    holding: tuple[tuple[Array, ...], ...]
    change: tuple[Array, ...]
    initial_length: Array
    stiffness: float
    stiffness_deviation: float
    free_length: float
    free_length_deviation: float

    def of(self, indices: Sequence[int]) -> Forces:
        """Return the forces of the runs with given indices."""
        return replace(
            self,
            holding=tuple(tuple(fit[index] for index in indices) for fit in self.holding),
            change=tuple(self.change[index] for index in indices),
            initial_length=self.initial_length[list(indices)],
        )

    @property
    def best(self) -> list[Array]:
        """Forces of each run for the best fit, N."""
        return self._force(list(self.holding[0]), self.stiffness, self.free_length)

    def draw(self, random: np.random.Generator) -> list[Array]:
        """Return the forces (N) of each run for a random draw of H, k_b and L_free within their uncertainty."""
        size = random.standard_normal(len(self.holding) - 1)
        holding = [
            best
            + sum(
                (z * (other[run] - best) for z, other in zip(size, self.holding[1:], strict=True)),
                0.0,
            )
            for run, best in enumerate(self.holding[0])
        ]
        stiffness = self.stiffness + self.stiffness_deviation * random.standard_normal()
        free_length = self.free_length + self.free_length_deviation * random.standard_normal()
        return self._force(holding, stiffness, free_length)

    def _force(self, holding: list[Array], stiffness: float, free_length: float) -> list[Array]:
        return [
            force + stiffness * (free_length - initial - change)
            for force, initial, change in zip(
                holding, self.initial_length, self.change, strict=True
            )
        ]


def forces_of(
    traverses: Sequence[Traverse],
    parameters: Parameters,
    locomotion: LocomotionResult,
    stiffness: Estimate,
    reference: ReferenceValues,
) -> Forces:
    """Return the forces from the locomotion fit, the bellows' ``stiffness`` and the reference values."""
    fits = [(parameters, locomotion.fit), *locomotion.variants, (parameters, locomotion.stiffer)]
    holding = tuple(holding_forces(traverses, values, fit) for values, fit in fits)
    free_length = reference.estimate("unstressed_length")
    return Forces(
        holding=holding,
        change=tuple(traverse.length.length_change for traverse in traverses),
        initial_length=locomotion.initial_length,
        stiffness=parameters.bellows_stiffness,
        stiffness_deviation=np.nan_to_num(stiffness.spread) / quantile(np.inf),
        free_length=free_length.value,
        free_length_deviation=free_length.spread / quantile(np.inf),
    )
