# SPDX-License-Identifier: Apache-2.0
"""Entry points of the optimizer node and of the commands that use ROS."""

from worm_msgs.executable import deferred_command, node

optimizer_node = node(
    "optimizer_node",
    "Answers requests for gaits from exact robust fronts.",
    "worm_optimizer.search.search_settings",
    "worm_optimizer.nodes.optimizer_node",
)
campaign = deferred_command("worm_optimizer.commands.campaign")
console = deferred_command("worm_optimizer.commands.console")
demo = deferred_command("worm_optimizer.commands.demo")
operate = deferred_command("worm_optimizer.commands.operate")
start = deferred_command("worm_optimizer.commands.start")
