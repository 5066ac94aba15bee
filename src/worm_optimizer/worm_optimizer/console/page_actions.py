# SPDX-License-Identifier: Apache-2.0
"""Commands of the pages, which the command thread executes. They make the same calls as `worm_optimizer operate`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from worm_model.twin.data.records import StateRecord
from worm_optimizer.console.robot_worker import STOP_PRESSED
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import OperatorNode, RejectedStartError
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.bring_up import Say, new_bag, recorded
from worm_optimizer.operation.system import recorder_of
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import SAME_LENGTH, GaitRequest, Objective

_GAITS = 32  # number of equal steps into which the displayed front is divided by speed


@dataclass(frozen=True)
class Front:
    """Gaits of a front by rising speed, among them the ``cruise``; ``description`` is the margin with its reason."""

    gaits: tuple[Prediction, ...]
    cruise: Prediction
    description: str

    @property
    def groove_phase(self) -> float:
        """Groove phase for which the front was computed, m."""
        return self.cruise.groove_phase


def phase_change(twin: StateRecord | None, front: Front | None) -> float:
    """Return the groove phase according to the twin minus that of a front, m; 0 if one of them is missing."""
    return 0.0 if twin is None or front is None else twin.groove_phase - front.groove_phase


def initial_length(twin: StateRecord | None, front: Front | None = None) -> float:
    """Return L0 according to the twin, m, 0 without a twin; that of a front as long as this front holds.

    Gaits of a front often lie on an edge, so a smaller difference, too, would let their predictions contradict it.
    """
    change = phase_change(twin, front)
    known = 0.0 if twin is None else twin.initial_length
    return known - change if abs(change) < SAME_LENGTH else known


def read_front(node: OperatorNode, direction: int, initial_length: float) -> Front:
    """Return gaits of the front at evenly spaced speeds, and the cruise.

    Args:
        node: the operator.
        direction: FORWARD or REVERSE.
        initial_length: length of the robot at rest, m; 0 for the length in the optimizer's parameters.
    """

    def request(objective: Objective, value: float = 0.0) -> Prediction:
        return node.request_gait(GaitRequest(objective, value), direction, initial_length)[0]

    require_optimizer(node)
    cruise, message = node.request_gait(GaitRequest(Objective.CRUISE), direction, initial_length)
    gaits, fastest = [request(Objective.MIN_POWER)], request(Objective.MAX_SPEED)
    step = (fastest.speed - gaits[0].speed) / _GAITS
    for number in range(1, _GAITS):
        speed = gaits[0].speed + number * step
        if speed > gaits[-1].speed:  # the previous gait may be faster than requested
            gaits.append(request(Objective.MIN_POWER_AT_SPEED, speed))
    by_speed = {gait.speed: gait for gait in (*gaits, fastest, cruise)}
    gaits = [by_speed[speed] for speed in sorted(by_speed)]
    return Front(tuple(gaits), cruise, message.split(";")[0])


def described(front: Front, before: Front | None) -> str:
    """Return what there is to say about a front, and why it ends elsewhere than the one before."""
    text = f"For groove phase {1e3 * front.groove_phase:.1f} mm: {front.description}"
    end, old = (1e3 * f.gaits[-1].speed for f in (front, before or front))
    if before is None or abs(end - old) < 0.005:
        return text
    return (
        f"The front now ends at {end:.2f} mm/s; for groove phase {1e3 * before.groove_phase:.1f} mm it ended at "
        f"{old:.2f} mm/s. {text}"
    )


def require_optimizer(node: OperatorNode) -> None:
    """Raise `OperatorError` if there is no optimizer."""
    if not node.has_optimizer():
        raise OperatorError("there is no optimizer: ./worm start starts one")


def run(
    node: OperatorNode,
    command: GaitCommand,
    folder: Path,
    parameter_file: str,
    cancellation: Callable[[], str],
    report: Say,
) -> str:
    """Run a gait, record it into a new bag, and return its result as text.

    Args:
        node: the operator.
        command: the gait, and the condition at which its run ends.
        folder: folder of the new bag.
        parameter_file: parameters to store in the bag; empty: the paper's values.
        cancellation: returns the reason why the run must end; empty if it may continue. As long as there is a reason,
            no heartbeats are sent, and the robot comes to rest.
        report: called with each line of progress.
    """
    bag, conditions = new_bag(folder), node.conditions()
    recorder = recorder_of(node.get_namespace(), bag, parameter_file, conditions)
    with recorded(node, recorder) as bag:
        if why := cancellation():
            raise OperatorError(f"not started: {why}")
        with node.started(command, lambda: not cancellation()) as gait_run:
            node.follow(gait_run, lambda now: report(cancellation() or f"running: {now}"))
            result, why = gait_run.result, cancellation()
        if gait_run.rejected:
            raise RejectedStartError(result.message)
        report(f"{why or result.message}; closing the recording")
    text = "; ".join(filter(None, (result.message, why, f"recorded in {bag.name}")))
    if not (result.success or why == STOP_PRESSED):  # a stop by a person is no error
        raise OperatorError(text)
    return text
