# SPDX-License-Identifier: Apache-2.0
"""The executables that are nodes."""

from worm_msgs.executable import deferred

optimizer_node = deferred("worm_optimizer.nodes.optimizer_node")
