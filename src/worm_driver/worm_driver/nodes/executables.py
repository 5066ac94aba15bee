# SPDX-License-Identifier: Apache-2.0
"""Entry points of the nodes."""

from worm_msgs.executable import deferred

driver_node = deferred("worm_driver.nodes.driver_node")
tracker_node = deferred("worm_driver.nodes.tracker_node")
virtual_robot = deferred("worm_driver.nodes.virtual_robot_node")
