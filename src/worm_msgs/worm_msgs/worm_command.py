# SPDX-License-Identifier: Apache-2.0
"""Command ``worm`` of an installation by pip: ``worm replay`` runs the command that a package calls replay."""

from __future__ import annotations

import re
import sys
from importlib.metadata import entry_points, version

from worm_msgs.command_parser import BAD_INPUT, DONE, notifier
from worm_msgs.yaml_file import unknown_name

_ROS = re.compile(
    r"rclpy|launch|rcl_interfaces|builtin_interfaces|ament_index_python|std_srvs|\w+_msgs"
)
_notify = notifier("worm")


def is_of_ros(module: str) -> bool:
    """Return True if a module that cannot be imported belongs to ROS, or is generated in a workspace."""
    return _ROS.fullmatch(module.partition(".")[0]) is not None


def main() -> int:
    """Run the command that the first argument names, with the other arguments, and return its exit status."""
    commands = {entry.name: entry for entry in entry_points(group="worm.commands")}
    name, *arguments = sys.argv[1:] or [""]
    if name == "--version":
        sys.stdout.write(f"worm {version('worm_msgs')}\n")
        return DONE
    if name in ("help", "-h", "--help"):
        names = ", ".join(sorted(commands))
        sys.stdout.write(f"usage: worm COMMAND [ARGS]; worm COMMAND --help\n\ncommands: {names}\n")
        return DONE
    if name not in commands:
        _notify(f"{unknown_name('command', name, sorted(commands))}; see worm --help")
        return BAD_INPUT
    sys.argv = [name, *arguments]
    try:
        status: int | None = commands[name].load()()
    except ModuleNotFoundError as error:
        if not is_of_ros(error.name or ""):
            raise
        _notify(f"{name} needs ROS 2, as {error.name} is missing: use a built workspace (./worm)")
        return BAD_INPUT
    return status or DONE
