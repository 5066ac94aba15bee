# SPDX-License-Identifier: Apache-2.0
"""Search for robust gaits: exact fronts, NSGA-II, the margin and its cliff, requests."""
