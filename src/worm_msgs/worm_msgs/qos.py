# SPDX-License-Identifier: Apache-2.0
"""Qualities of service that publisher and subscriber must share."""

from rclpy.qos import DurabilityPolicy, QoSProfile

#: the newest word, for those who come late, too: `gait_state`, `emergency_stop`
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
