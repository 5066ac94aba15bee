# SPDX-License-Identifier: Apache-2.0
"""Quality of service that publisher and subscriber must share."""

from rclpy.qos import DurabilityPolicy, QoSProfile

#: A late subscriber also receives the latest message. The topics `gait_state` and `twin/memory` use this profile.
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
