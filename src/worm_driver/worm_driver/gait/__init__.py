# SPDX-License-Identifier: Apache-2.0
"""Gaits: waveform, limits, the state machine that plays them, and metrics of runs. Time is always an argument."""
