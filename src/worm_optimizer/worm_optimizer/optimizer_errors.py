# SPDX-License-Identifier: Apache-2.0
"""The one error of this package."""

from __future__ import annotations

from worm_model.errors import InputError


class OptimizerError(InputError):
    """A setting or a request is not admissible. The message names it, the reason and what to do."""
