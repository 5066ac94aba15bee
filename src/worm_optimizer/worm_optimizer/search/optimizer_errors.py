# SPDX-License-Identifier: Apache-2.0
"""The one error of this package."""


class OptimizerError(ValueError):
    """A setting or a request is not admissible; the message says which, why and what to do."""
