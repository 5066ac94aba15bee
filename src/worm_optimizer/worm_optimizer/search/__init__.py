# SPDX-License-Identifier: Apache-2.0
"""Robust gaits: the problem, the exhaustive map, fronts, the margin and its cliff, requests."""
