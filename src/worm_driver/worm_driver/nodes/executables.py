# SPDX-License-Identifier: Apache-2.0
"""Entry points of the nodes."""

from worm_msgs.executable import deferred, node

driver_node = node(
    "driver",
    "Run gaits on the robot and publish its measurements, as a lifecycle node.",
    "worm_driver.nodes.driver_parameters",
    "worm_driver.nodes.driver_node",
)
tracker_node = node(
    "tracker",
    "Measure the positions of both modules in the images of a camera.",
    "worm_driver.tracking.tracker_setup",
    "worm_driver.nodes.tracker_node",
)
virtual_robot = deferred("worm_driver.nodes.virtual_robot_command")
