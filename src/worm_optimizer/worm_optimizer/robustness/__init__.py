# SPDX-License-Identifier: Apache-2.0
"""Robustness of gaits with uncertain parameters: scenarios and success probabilities."""
