# SPDX-License-Identifier: Apache-2.0
"""Gaits of a search: what is evaluated, what each gait achieves, and the limits of its actuators."""
