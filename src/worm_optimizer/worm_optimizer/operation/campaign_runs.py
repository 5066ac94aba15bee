# SPDX-License-Identifier: Apache-2.0
"""Runs of a campaign: gaits from rest, each recorded into its own bag, and the tuning of gaits from such runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from worm_model.analysis.run_metrics import last_played_gait
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_run
from worm_model.errors import RecordingError
from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import OPTIMIZER
from worm_optimizer.operation.bring_up import CYCLES, Say, Session, recorded, session
from worm_optimizer.operation.system import Robot
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.robustness.tuning import TuneState, Tuning

#: Prepares a run. Arguments: session, and description of the run.
Prepare = Callable[[Session, str], None]

_ELSEWHERE = "this run may have started at another position and with bent fins"


def at_once(_running: Session, _text: str) -> None:
    """Do nothing before a run."""


def run_gaits(
    robot: Robot,
    orders: Mapping[str, GaitCommand],
    folder: Path,
    logs: Path,
    say: Say,
    prepare: Prepare = at_once,
) -> None:
    """Run each gait and record it as ``folder/NAME``. After the last gait, bring the robot to rest and release torque.

    Gaits with a complete recording are skipped. An incomplete recording is renamed before its gait is run again. All
    processes have ended when this function returns or raises an exception.

    Args:
        robot: the robot.
        orders: commands to run, by the name of the recording.
        folder: folder of the recordings.
        logs: folder of the log files.
        say: called with each line of progress.
        prepare: called before each gait; raises an exception to end the campaign.
    """
    with gait_recorder(robot, logs, say, prepare) as record:
        for name, order in orders.items():
            record(folder / name, order)


@contextmanager
def gait_recorder(
    robot: Robot, logs: Path, say: Say, prepare: Prepare = at_once
) -> Iterator[Callable[[Path, GaitCommand], None]]:
    """Provide a function that runs a gait and records it as a bag; see `run_gaits`. The first run starts the nodes."""
    with ExitStack() as nodes:
        start = cache(lambda: nodes.enter_context(_active_robot(robot, logs, say)))
        latest: int | None = None

        def record(bag: Path, order: GaitCommand) -> None:
            nonlocal latest
            if is_recorded(bag):
                say(f"{bag.name}: recorded already")
                return
            running = start()
            node = running.node
            prepare(running, f"{bag.name}: {order}")
            put_aside(bag, say)
            say(f"{bag.name}: {order}")
            with recorded(node, robot.recorder(bag), running.group):
                if latest not in (None, node.run_number):
                    say(f"{bag.name}: another operator ran a gait in the meantime: {_ELSEWHERE}")
                running.run_gait(order)
            latest = node.run_number
            if not is_recorded(bag):
                say(f"{bag.name}: the tracker missed the end of the gait; --resume runs it again")

        yield record


@contextmanager
def _active_robot(robot: Robot, logs: Path, say: Say) -> Iterator[Session]:
    """Start the robot's nodes and activate its driver; at the end, bring it to rest and release the torque."""
    whole = robot.system()
    # The front is known, so that no optimizer is needed.
    system = replace(whole, nodes=tuple(each for each in whole.nodes if each.name != OPTIMIZER))
    with session(system, logs, say) as running:
        running.node.require_tracker()
        running.activate()
        yield running
        running.release()


def is_recorded(bag: Path) -> bool:
    """Return True if a bag contains a gait that has ended, and tracker samples up to the end of its last cycle."""
    if not bag.is_dir():
        return False
    try:
        with open_bag(bag) as content:
            run = read_run(content)
        played = last_played_gait(run.gait_state)
    except (BagError, RecordingError):
        return False
    stamps = run.tracker.stamp
    ended = played.end is not None and stamps.size > 0
    return ended and played.whole_cycles_until(int(stamps[-1])) == played.cycles


def put_aside(bag: Path, say: Say) -> None:
    """Rename a bag or folder if it exists, so that nothing is lost and a new one can be created under its name."""
    if not bag.exists():
        return
    number = 1
    while (aside := bag.with_name(f"{bag.name}_unfinished_{number}")).exists():
        number += 1
    bag.rename(aside)
    say(f"{bag.name}: is incomplete, renamed to {aside.name}")


MOST_RUNS = 5
TUNING = "tuning"  # folder of a campaign's bags

#: Runs a gait and returns its bag. Arguments: the gait, and the number of the run from 1. Raises an exception to end.
Record = Callable[[Gait, int], Path]
#: Returns the next step from the bags so far. Raises an exception if the last run was not measured.
Measure = Callable[[Sequence[Path]], Tuning]


@dataclass(frozen=True)
class Tuned:
    """Last step of a tuning, and the bags of its runs. In the state `RUN` the runs did not suffice."""

    step: Tuning
    bags: tuple[Path, ...]


def tune_gait(gait: Gait, record: Record, measure: Measure, say: Callable[[str], None]) -> Tuned:
    """Run a gait and its successors, at most `MOST_RUNS` in total, until one is done or none is possible.

    Args:
        gait: the first gait.
        record: runs and records a gait.
        measure: the step after the bags so far.
        say: called with each line of progress.
    """
    bags: list[Path] = []
    for number in range(1, MOST_RUNS + 1):
        say(
            f"run {number} of at most {MOST_RUNS}: {1e3 * gait.stroke:.1f} mm, {gait.frequency:.4g} Hz"
        )
        bags.append(record(gait, number))
        step = measure(bags)
        if step.state is not TuneState.RUN:
            break
        gait = step.gait
    return Tuned(step, tuple(bags))


def tune_gaits(
    gaits: Mapping[str, tuple[Gait, Measure]],
    record: Callable[[Path, GaitCommand], None],
    folder: Path,
    say: Say,
) -> dict[str, Tuned]:
    """Tune gaits one after the other, with run N recorded as ``folder/tuning/NAME_N``; see `tune_gait`.

    Args:
        gaits: by name, the first gait and the measurement of its bags.
        record: see `gait_recorder`.
        folder: folder of the campaign.
        say: called with each line of progress.
    """
    runs = folder / TUNING
    runs.mkdir(parents=True, exist_ok=True)

    def tuned(name: str, first: Gait, measure: Measure) -> Tuned:
        def run(gait: Gait, number: int) -> Path:
            bag = runs / f"{name}_{number}"
            record(bag, GaitCommand(gait, CYCLES))
            return bag

        return tune_gait(first, run, measure, say)

    return {name: tuned(name, *each) for name, each in gaits.items()}
