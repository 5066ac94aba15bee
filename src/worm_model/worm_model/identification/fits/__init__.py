# SPDX-License-Identifier: Apache-2.0
"""Fits of the stages: costs, predictions, robust least squares, and intervals."""
