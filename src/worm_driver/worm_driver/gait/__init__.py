# SPDX-License-Identifier: Apache-2.0
"""Gaits: what they ask for, how they are played, what was measured of them. Pure."""
