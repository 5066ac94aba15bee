# SPDX-License-Identifier: Apache-2.0
"""Hybrid simulator of actuation, locomotion and energy, with closed forms between events."""
