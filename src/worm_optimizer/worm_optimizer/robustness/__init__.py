# SPDX-License-Identifier: Apache-2.0
"""Robustness of gaits under uncertain parameters: scenarios and success probabilities."""
