# SPDX-License-Identifier: Apache-2.0
"""Quality of service that publisher and subscriber must share."""

from rclpy.qos import DurabilityPolicy, QoSProfile

#: A late subscriber receives the latest message, too. `gait_state` and `emergency_stop` use this profile.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
