# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: ratios and rates, each measured in one run; nothing here is a test and nothing is stored."""

import sys
from pathlib import Path

import worm_model  # noqa: F401 (before NumPy, as in the executables: it leaves small matrices to one thread)

# The helpers of the tests import each other by their names.
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests/helpers"))
