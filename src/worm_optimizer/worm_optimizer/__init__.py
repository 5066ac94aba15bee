# SPDX-License-Identifier: Apache-2.0
"""Robust gaits for the robot, and bring-up of its node graph."""

import worm_model  # noqa: F401  # Before NumPy, because it limits NumPy's threads.
