# SPDX-License-Identifier: Apache-2.0
"""Executables that are nodes."""

from worm_msgs.executable import deferred, node

play = deferred("worm_model.nodes.play_node")
record = deferred("worm_model.nodes.record_node")
twin_node = node(
    "twin_node",
    "Simulates the robot during a run, compares simulation and measurements, and reports changes.",
    "worm_model.twin.twin_settings",
    "worm_model.nodes.twin_node",
)
