# SPDX-License-Identifier: Apache-2.0
"""Figures of a run and of its parameters."""
