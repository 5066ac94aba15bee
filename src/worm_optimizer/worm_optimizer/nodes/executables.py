# SPDX-License-Identifier: Apache-2.0
"""The executables that are nodes, and the commands that work with them."""

from worm_msgs.executable import deferred, deferred_command

optimizer_node = deferred("worm_optimizer.nodes.optimizer_node")
campaign = deferred_command("worm_optimizer.commands.campaign")
console = deferred_command("worm_optimizer.commands.console")
demo = deferred_command("worm_optimizer.commands.demo")
operate = deferred_command("worm_optimizer.commands.operate")
start = deferred_command("worm_optimizer.commands.start")
