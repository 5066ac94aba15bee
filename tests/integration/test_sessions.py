# SPDX-License-Identifier: Apache-2.0
"""Gaits in a row on one graph, each recorded by `operate run --record`: live twin, table and replay agree."""

import json
import sys
from pathlib import Path

import pytest
from commander import EVERY_STATE
from harness import TIMEOUT_S, Probe, Processes

from worm_model.commands import bags, replay
from worm_model.nodes.twin_messages import nanoseconds
from worm_msgs.msg import GaitState, TwinEvent, TwinResiduals

INFORMATION = "near_edge"  # code of an event that judges nothing
MANY = "40"  # cycles of a gait that is ended earlier


USUAL = ("--stroke", "0.07", "--frequency", "0.3", "--cycles", "3")
BACK = ("--stroke", "0.08", "--frequency", "0.3", "--direction", "-1")
#: options of each gait of the session; a gait of `MANY` cycles is stopped
SESSION = (USUAL, (*BACK, "--cycles", MANY), USUAL)


class Lab:
    """The graph, and an operator who uses commands."""

    def __init__(self, processes: Processes, probe: Probe, folder: Path) -> None:
        self.processes, self.probe = processes, probe
        place = ("--set", f"directory={folder / 'robot'}")
        start = processes.start_executable("worm_optimizer", "start", "--virtual", *place)
        start.wait_for_line("ready: ", 4 * TIMEOUT_S)
        self.states = probe.collect(GaitState, "gait_state", EVERY_STATE)
        self.residuals = probe.collect(TwinResiduals, "twin/residuals", 100_000)
        self.events = probe.collect(TwinEvent, "twin/events")

    def run(self, gait: tuple[str, ...], folder: Path) -> Path:
        """Play and record a gait, which the live twin finds healthy, and return its bag."""
        self.states.clear()
        process = self.processes.operate("run", *gait, "--record", str(folder), "--json")
        if MANY in gait:
            self.probe.wait_for(
                lambda: self.states and self.states[-1].cycle > 2, "third cycle", 4 * TIMEOUT_S
            )
            assert self.processes.operate("stop").wait(4 * TIMEOUT_S) == 0
        assert process.wait(8 * TIMEOUT_S) == (1 if MANY in gait else 0), process.output()

        def onset() -> int:
            return max((nanoseconds(state.onset) for state in self.states), default=0)

        self.probe.wait_for(
            lambda: onset() and self.states[-1].state == GaitState.IDLE, "end of the gait"
        )
        end = self.states[-1].header.stamp
        self.probe.wait_for(
            lambda: self.residuals and self.residuals[-1].header.stamp.sec > end.sec, "residuals"
        )

        def since_onset(messages: list) -> list:
            return [m for m in messages if nanoseconds(m.header.stamp) >= onset()]

        assert max(m.health for m in since_onset(self.residuals)) == TwinResiduals.HEALTHY
        assert {m.code for m in since_onset(self.events)} <= {"", INFORMATION}
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


@pytest.mark.night
@pytest.mark.timeout(1200)
def test_gaits_in_a_row_are_healthy_live_in_the_table_and_replayed(
    processes: Processes, probe: Probe, tmp_path: Path, capsys, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    lab = Lab(processes, probe, tmp_path)
    made = [lab.run(gait, tmp_path / "bags") for gait in SESSION]
    # Only the table uses this cache: the processes above use the compiled code of the user's cache.
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    rows = printed(bags.main, capsys, monkeypatch, "table", str(tmp_path / "bags"))["runs"]
    health = {Path(row["bag"]).name: row["health"] for row in rows}
    assert health == {bag.name: "healthy" for bag in made}
    for bag in made:
        (run,) = printed(replay.main, capsys, monkeypatch, str(bag))["runs"]
        judged = [event for event in run["events"] if event["code"] != INFORMATION]
        assert (run["health"], judged) == ("healthy", [])
        whole = [cycle for cycle in run["cycles"] if cycle["complete"]]
        assert whole
        assert not [cycle["not_judged"] for cycle in whole if cycle["not_judged"]]
