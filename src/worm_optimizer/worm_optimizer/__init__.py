# SPDX-License-Identifier: Apache-2.0
"""Robust gaits for the worm, and the bring-up of its node graph."""

import worm_model  # noqa: F401  # before NumPy, to whose threads it sees
