# SPDX-License-Identifier: Apache-2.0
"""Evaluation of gaits for a search: optimisation tasks, evaluated gaits, and limits of the actuators."""
