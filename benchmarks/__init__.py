# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: ratios and rates, each measured in one run; nothing here is a test and nothing is stored."""
