# SPDX-License-Identifier: Apache-2.0
"""Commands of the pages, which the command thread executes. They make the same calls as `worm_optimizer operate`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from worm_model.twin.data.records import StateRecord
from worm_optimizer.console.gait_fields import DriverLimits
from worm_optimizer.console.robot_worker import STOP_PRESSED
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import DRIVER, OperatorNode
from worm_optimizer.nodes.service_caller import OperatorError
from worm_optimizer.operation.bring_up import Say, new_bag, recorded
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import SAME_LENGTH, GaitRequest, Objective

_GAITS = 32  # number of equal steps into which the displayed front is divided by speed
_FIRST_S = 5.0  # longest wait for the optimizer, s; meanwhile, no other command begins
_LIMITS = ("limits.max_stroke_m", "limits.max_frequency_hz", "limits.max_cable_speed_m_per_s")

_numbers: Iterator[int] = count(1)  # numbers in the names of recorders


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

    Raises:
        OperatorError: There is no optimizer, or it rejects a request or does not answer.
    """

    def request(objective: Objective, value: float = 0.0) -> Prediction:
        return node.request_gait(GaitRequest(objective, value), direction, initial_length)

    require_optimizer(node)
    cruise, description = request(Objective.CRUISE), node.front_description.split(";")[0]
    gaits, fastest = [request(Objective.MIN_POWER)], request(Objective.MAX_SPEED)
    step = (fastest.speed - gaits[0].speed) / _GAITS
    for number in range(1, _GAITS):
        speed = gaits[0].speed + number * step
        if speed > gaits[-1].speed:  # the previous gait may be faster than requested
            gaits.append(request(Objective.MIN_POWER_AT_SPEED, speed))
    by_speed = {gait.speed: gait for gait in (*gaits, fastest, cruise)}
    return Front(tuple(by_speed[speed] for speed in sorted(by_speed)), cruise, description)


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
    if not node.wait(lambda: node.has_optimizer, _FIRST_S):
        raise OperatorError("there is no optimizer: ./worm start starts one")


def driver_limits(node: OperatorNode) -> DriverLimits:
    """Return the driver's limits on gaits. Raises `OperatorError` if it does not answer."""
    return DriverLimits(*node.numbers(DRIVER, _LIMITS))


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

    Raises:
        OperatorError: The gait did not start, failed or was cancelled, or a node does not answer. A run that STOP ended
            raises no error. A rejected gait leaves no bag.
        InputError: The bag cannot be created.
    """
    recorder = f"console_{os.getpid()}_{next(_numbers)}"
    conditions = node.conditions()
    with recorded(node, new_bag(folder), parameter_file, conditions, recorder) as bag:
        if why := cancellation():
            raise OperatorError(f"not started: {why}")
        gait_run = node.begin(command, lambda: not cancellation())
        try:
            node.follow(gait_run, lambda now: report(cancellation() or f"running: {now}"))
            result, why = gait_run.result, cancellation()
        finally:
            gait_run.close()
        report(f"{why or result.message}; closing the recording")
    if gait_run.rejected:
        shutil.rmtree(bag)  # it contains no gait
        raise OperatorError(result.message)
    text = "; ".join(filter(None, (result.message, why, f"recorded in {bag.name}")))
    if not (result.success or why == STOP_PRESSED):  # a stop by a person is no error
        raise OperatorError(text)
    return text
