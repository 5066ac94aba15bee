# SPDX-License-Identifier: Apache-2.0
"""Executables that are nodes."""

from worm_msgs.executable import deferred

play = deferred("worm_model.nodes.play_node")
record = deferred("worm_model.nodes.record_node")
twin_node = deferred("worm_model.nodes.twin_node")
watch = deferred("worm_model.nodes.watch_node")
