# SPDX-License-Identifier: Apache-2.0
"""Recording of a single run into a new bag, with a recorder in addition to that of the node graph."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from worm_model.bags.formats.finding import METADATA_FILE, TIME_FIELD
from worm_model.errors import InputError
from worm_msgs.conditions import Conditions
from worm_optimizer.nodes.operator_node import OperatorNode, RejectedStartError
from worm_optimizer.operation.bring_up import recording, work_folder
from worm_optimizer.operation.processes import ProcessGroup
from worm_optimizer.operation.system import RECORDER, installed_system_file, settings_of


def new_bag(folder: Path, kind: str = "run") -> Path:
    """Create a folder of bags, and return the path of a new bag in it. The recorder inserts the time into the path.

    Args:
        folder: folder of bags.
        kind: first part of the bag's name, followed by the time.

    Raises:
        InputError: The folder is a bag, or cannot be created.
    """
    folder = folder.resolve()
    if (folder / METADATA_FILE).exists():
        raise InputError(f"{folder}: is a bag; give a folder that contains bags")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    return folder / f"{kind}_{TIME_FIELD}"


@contextmanager
def recorded(
    node: OperatorNode, bag: Path, parameter_file: str, conditions: Conditions, name: str
) -> Iterator[Path]:
    """Record during this context with a separate recorder, and provide the path of the bag; see `recording`.

    If the driver rejects the gait, the bag is removed.

    Args:
        node: the operator.
        bag: path of a new bag, see `new_bag`.
        parameter_file: parameter file to store in the bag; empty: none.
        conditions: conditions to store in the bag.
        name: last part of the name of the recorder's node, unique among all recorders.
    """
    system = installed_system_file().system(
        "robot",
        node.get_namespace().strip("/"),
        bag=str(bag),
        parameter_file=str(Path(parameter_file).resolve()) if parameter_file else "",
        **settings_of(conditions),
    )
    with (
        ExitStack() as removal,
        work_folder("record") as work,
        ProcessGroup(work / "logs") as group,
        recording(group, node, system.node(RECORDER), f"{RECORDER}_{name}") as path,
    ):
        try:
            yield path
        except (InputError, RejectedStartError):  # nothing moved
            removal.callback(shutil.rmtree, path)  # when the recorder has ended
            raise
