# SPDX-License-Identifier: Apache-2.0
"""A worm robot without hardware: servo bus and power sensor byte for byte, and a worm behind them."""
