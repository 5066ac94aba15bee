# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: ratios and rates, each measured in one run; nothing here is a test and nothing is stored."""

import worm_model  # noqa: F401 (before NumPy, as in the executables: it leaves small matrices to one thread)
