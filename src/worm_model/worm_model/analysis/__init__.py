# SPDX-License-Identifier: Apache-2.0
"""Metrics, tables and figures of a run, and figures of the model."""
