# SPDX-License-Identifier: Apache-2.0
"""The part of the demo with a robot in it: from the first process to a closed recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from worm_optimizer.operation.bring_up import CYCLES, RECORDER, Say, left_out, session
from worm_optimizer.operation.system import System
from worm_optimizer.orders import Order
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective

PATIENCE_S = 5.0  # between two lines that say that there is no gait yet


def drive(system: System, logs: Path, say: Say) -> Prediction:
    """Bring a system up, request a gait, run five cycles of it, and bring everything to its end.

    The bag is whole afterwards, and no process is left, whatever happens. Returns what the
    optimizer predicted. Raises `ProcessError` or `OperatorError` with the stage that failed.
    """
    with session(system, logs, say) as running:
        node = running.node
        prediction = node.request_gait(GaitRequest(Objective.CRUISE), now_and_then(say))
        gait = prediction.gait
        say(
            f"the optimizer answers: stroke {1e3 * gait.stroke:.1f} mm, frequency "
            f"{gait.frequency:.3f} Hz, margin {1e3 * gait.margin:.1f} mm"
        )
        running.activate()
        node.wait_for_recorder(RECORDER, left_out(system.node(RECORDER)))
        say(f"running {CYCLES} cycles, {CYCLES / gait.frequency:.0f} s")
        running.run_gait(Order(gait, CYCLES))
        running.release()
    return prediction


def now_and_then(say: Say) -> Callable[[str], None]:
    """A progress of `OperatorNode.request_gait` that tells the reason every few seconds."""
    last = [-PATIENCE_S]

    def progress(reason: str) -> None:
        if time.monotonic() > last[0] + PATIENCE_S:
            last[0] = time.monotonic()
            say(f"requesting a gait: {reason}")

    return progress
