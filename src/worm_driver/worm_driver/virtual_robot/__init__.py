# SPDX-License-Identifier: Apache-2.0
"""Virtual worm robot: servo bus and power sensor at byte level, and a plant that moves."""
