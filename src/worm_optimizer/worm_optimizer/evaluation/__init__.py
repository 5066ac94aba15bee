# SPDX-License-Identifier: Apache-2.0
"""Evaluation of the gaits of a search: tasks, their results, and limits of the actuators."""
