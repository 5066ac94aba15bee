# SPDX-License-Identifier: Apache-2.0
"""Ten gaits in a row on one graph, each recorded by `operate run --record`: live twin, table and replay agree."""

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from harness import LATCHED, TIMEOUT_S, Probe, Processes, VirtualWorm

from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_columns, read_run
from worm_model.bags.worm_topics import REPLAY_INPUTS
from worm_model.commands import bags, replay
from worm_model.twin.data.records import Health
from worm_msgs.msg import GaitState
from worm_optimizer.operation.processes import Process

NANOSECONDS = 10**9
INFORMATION = "near_edge"  # code of an event that judges nothing
MANY = "40"  # cycles of a gait that is ended earlier


@dataclass(frozen=True)
class Step:
    """Gait of the session; ``end`` is its outcome, ``hidden`` is True if the camera sees no marker."""

    gait: tuple[str, ...]
    cycles: str = "2"
    end: str = "completed"
    hidden: bool = False


USUAL = ("--stroke", "0.07", "--frequency", "0.3")
LONG = ("--stroke", "0.08", "--frequency", "0.3")
SHORT = ("--stroke", "0.06", "--frequency", "0.35")
BACK = ("--direction", "-1")
SESSION = (
    Step(USUAL, "3"),
    Step(USUAL),
    Step(LONG, MANY, "stopped"),
    Step(USUAL),
    Step((*USUAL, *BACK)),
    Step((*USUAL, *BACK), MANY, "cancelled"),
    Step(SHORT, hidden=True),
    Step(LONG),
    Step(USUAL, MANY, "stopped"),
    Step(SHORT, "3"),
)


class Lab:
    """The graph, and an operator who uses commands."""

    def __init__(self, processes: Processes, probe: Probe, folder: Path) -> None:
        self.processes, self.probe, self.folder = processes, probe, folder
        worm = VirtualWorm(processes, probe, folder)
        # `operate run` would search for a missing optimizer for seconds; it records by itself
        nodes = tuple(node for node in worm.system.nodes if node.name != "recorder")
        worm.system = replace(worm.system, nodes=nodes)
        worm.start()
        processes.processes["twin"].wait_for_line("twin ready", 4 * TIMEOUT_S)
        worm.wait_until_active()
        self.states = probe.collect(GaitState, "gait_state", LATCHED)
        self._commands = 0

    def begin(self, *arguments: str) -> Process:
        self._commands += 1
        arguments = (*arguments, "--timeout", f"{TIMEOUT_S:g}")
        return self.processes.start_executable(
            "worm_optimizer", "operate", *arguments, name=f"operate_{self._commands}"
        )

    def operate(self, *arguments: str) -> None:
        process = self.begin(*arguments)
        assert process.wait(4 * TIMEOUT_S) == 0, process.output()

    def run(self, step: Step, folder: Path) -> Path:
        """Play and record a gait, and return its bag."""
        if step.hidden:
            self.operate("fault", "occluded", "--duration", "1000")
        arguments = ("run", *step.gait, "--cycles", step.cycles, "--record", str(folder), "--json")
        self.states.clear()
        process = self.begin(*arguments)
        if step.end != "completed":
            self.probe.wait_for(
                lambda: self.states and self.states[-1].cycle > 2, "third cycle", 4 * TIMEOUT_S
            )
            if step.end == "stopped":
                self.operate("stop")
            else:
                process.interrupt()
        status = process.wait(8 * TIMEOUT_S)
        assert status == (0 if step.end == "completed" else 1), process.output()
        if step.hidden:
            self.operate("fault", "clear")
        result = json.loads(next(s for s in process.output().splitlines() if s[:1] == "{"))
        return Path(result["bag"])


def printed(main, capsys, monkeypatch, *arguments: str) -> dict:
    monkeypatch.setattr(sys, "argv", ["command", *arguments, "--json"])
    try:
        status = main()
    except SystemExit as left:
        status = left.code
    output = capsys.readouterr()
    assert status in (0, None), output.err
    return json.loads(output.out.splitlines()[-1])


def live_outcome(bag: Path, onset_s: float) -> tuple[str, list[tuple[str, int]]]:
    """Return the worst health, and codes with their cycles, that the live twin published into a bag after an onset."""
    with open_bag(bag) as opened:
        names = {topic.name.rpartition("twin/")[2]: topic for topic in opened.topics.values()}
        topics = [names[name] for name in ("residuals", "events") if names[name].count]
        columns = read_columns(opened, topics)
        onset = read_run(opened, names=REPLAY_INPUTS).origin + round(onset_s * NANOSECONDS)

    def stamps(name: str) -> np.ndarray:
        numbers = columns[names[name].name].numbers
        return numbers["header.stamp.sec"].astype(np.int64) * NANOSECONDS + numbers[
            "header.stamp.nanosec"
        ].astype(np.int64)

    health = columns[names["residuals"].name].numbers["health"][stamps("residuals") >= onset]
    codes = []
    if names["events"].name in columns:
        events = columns[names["events"].name]
        for row, stamp in enumerate(stamps("events").tolist()):
            if stamp >= onset and events.texts["code"][row] not in ("", INFORMATION):
                codes.append((events.texts["code"][row], int(events.numbers["cycle"][row])))
    return Health(int(health.max(initial=0))).name.lower(), codes


@pytest.mark.night
@pytest.mark.timeout(1200)
def test_ten_gaits_in_a_row_are_healthy_live_in_the_table_and_replayed(
    processes: Processes, probe: Probe, tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    lab = Lab(processes, probe, tmp_path)
    made = [lab.run(step, tmp_path / "bags") for step in SESSION]
    # Only the table uses this cache: the processes above use the compiled code of the user's cache.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rows = printed(bags.main, capsys, monkeypatch, "table", str(tmp_path / "bags"))["runs"]
    by_bag = {Path(row["bag"]).name: row for row in rows}
    assert len(by_bag) == len(SESSION)
    compared = 0
    for step, bag in zip(SESSION, made, strict=True):
        row = by_bag[bag.name]
        assert row["health"] == "healthy", (step, row)
        found = printed(replay.main, capsys, monkeypatch, str(bag))
        (run,) = found["runs"]
        assert run["health"] == "healthy"
        health, codes = live_outcome(bag, run["onset_s"])
        judged = [event for event in run["events"] if event["code"] != INFORMATION]
        assert (run["health"], judged) == (health, codes) == ("healthy", [])
        whole = [cycle for cycle in run["cycles"] if cycle["complete"]]
        assert whole
        assert not [cycle["not_judged"] for cycle in whole if cycle["not_judged"]]
        # On a busy machine, samples of the tracker can be late at the end of a cycle. Its count is then unknown.
        measured = [cycle for cycle in whole if cycle["measured_grooves"] is not None]
        assert not (measured and step.hidden)
        compared += len(measured)
        for cycle in measured:
            # The first cycle begins with fins that the gait before has deflected by up to a third of a pitch.
            off = abs(cycle["grooves"] - cycle["measured_grooves"])
            assert off < (0.75 if cycle["number"] == 1 else 0.25), (step, cycle)
    assert compared
