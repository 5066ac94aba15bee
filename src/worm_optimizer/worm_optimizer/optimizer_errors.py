# SPDX-License-Identifier: Apache-2.0
"""Error of inadmissible settings and requests."""

from __future__ import annotations

from worm_model.errors import InputError


class OptimizerError(InputError):
    """A setting or a request is inadmissible. The message contains its name, the reason and what to do."""
