# SPDX-License-Identifier: Apache-2.0
"""Quality of service that publisher and subscriber must share."""

from rclpy.qos import DurabilityPolicy, QoSProfile

#: Late subscribers receive the latest message, too, as of `gait_state` and `emergency_stop`.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
