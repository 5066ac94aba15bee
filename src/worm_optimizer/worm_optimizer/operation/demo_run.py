# SPDX-License-Identifier: Apache-2.0
"""Robot part of the demo, from the start of the first process to a closed recording."""

from __future__ import annotations

from pathlib import Path

from worm_optimizer.operation.bring_up import (
    CYCLES,
    RECORDER,
    Say,
    bag_of,
    left_out,
    session,
)
from worm_optimizer.operation.system import System
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective


def drive(system: System, logs: Path, say: Say) -> tuple[Prediction, Path]:
    """Bring a system up, run five cycles of a requested gait, and shut everything down.

    Return the prediction and the bag. Afterwards the bag is closed and no process remains, also after an exception.

    Args:
        system: the nodes, including a recorder.
        logs: folder of the log files.
        say: called with each line of progress.

    Raises:
        ProcessError, OperatorError: A stage failed; the message names it.
    """
    with session(system, logs, say) as running:
        node = running.node
        prediction = node.request_gait(GaitRequest(Objective.CRUISE))
        gait = prediction.gait
        say(
            f"the optimizer answers: stroke {1e3 * gait.stroke:.1f} mm, frequency "
            f"{gait.frequency:.3f} Hz, margin {1e3 * gait.margin:.1f} mm"
        )
        bag = bag_of(running.group.processes[RECORDER])
        running.activate()
        node.graph.wait_for_recorder(RECORDER, left_out(system.node(RECORDER)))
        say(f"running {CYCLES} cycles, {CYCLES / gait.frequency:.0f} s")
        running.run_gait(GaitCommand(gait, CYCLES))
        running.release()
    return prediction, bag
