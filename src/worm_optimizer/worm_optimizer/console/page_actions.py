# SPDX-License-Identifier: Apache-2.0
"""What a person does from a page, for the worker to do: the same calls that `operate` makes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path

from worm_optimizer.nodes.operator_node import OperatorError, OperatorNode
from worm_optimizer.operation.recorded_run import new_bag, recorded
from worm_optimizer.orders import Order, Progress
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective

_GAITS = 32  # of a front that is shown

_numbers: Iterator[int] = count(1)  # of recorders


def read_front(
    node: OperatorNode, direction: int, initial_length: float, say: Callable[[str], None]
) -> list[Prediction]:
    """Gaits of the front evenly over its speeds, the slowest first.

    ``initial_length`` in m, 0: that of the parameters. Raises `OperatorError`.
    """

    def request(objective: Objective, value: float = 0.0) -> Prediction:
        return node.request_gait(GaitRequest(objective, value), direction, initial_length)

    gaits, fastest = [request(Objective.MIN_POWER)], request(Objective.MAX_SPEED)
    step = (fastest.speed - gaits[0].speed) / _GAITS
    for place in range(1, _GAITS):
        say(f"reading the front: {place} of {_GAITS} gaits")
        speed = gaits[0].speed + place * step
        if speed > gaits[-1].speed:  # the gait of the speed before may be faster than was requested
            gaits.append(request(Objective.MIN_POWER_AT_SPEED, speed))
    return gaits if fastest.speed <= gaits[-1].speed else [*gaits, fastest]


def take_parameters(node: OperatorNode, file: str) -> str:
    """Have the twin and the optimizer take a parameter file, empty for the paper's values. Raises `OperatorError`."""
    node.take_parameters("twin", file)
    try:
        node.take_parameters("optimizer", file)
    except OperatorError as error:
        raise OperatorError(f"only the twin has taken it: {error}") from None
    return f"twin and optimizer have taken {Path(file).name or 'the paper’s values'} over"


def run(
    node: OperatorNode,
    order: Order,
    folder: Path,
    parameters: str,
    unwanted: Callable[[], str],
    progress: Progress,
) -> str:
    """Run a gait and record it into a new bag in a folder; what came of it, in words.

    Once ``unwanted`` says why, its heartbeat ends, and the robot comes to rest. Raises `OperatorError` or `InputError`.
    """
    bag = new_bag(folder)
    with recorded(node, bag, parameters, f"console_{os.getpid()}_{next(_numbers)}"):
        if why := unwanted():
            raise OperatorError(f"not begun: {why}")
        going = node.begin(order, lambda: not unwanted())
        try:
            node.follow(going, progress)
            result, why = going.result, unwanted()
        finally:
            going.close()
    words = f"recorded in {bag.name}"
    if not result.success:
        raise OperatorError("; ".join(filter(None, (result.message, why, words))))
    return f"{result.message}; {words}"
