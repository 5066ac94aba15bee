# SPDX-License-Identifier: Apache-2.0
"""Search for robust gaits: exact fronts, NSGA-II, the margin scan, requests for single gaits, and largest loads."""
