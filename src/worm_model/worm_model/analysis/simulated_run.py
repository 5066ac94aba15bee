# SPDX-License-Identifier: Apache-2.0
"""Simulated gait over time, as a table and as a recording of ideal instruments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model import run
from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.closed_form import front_groove, groove_phase
from worm_model.simulation.simulator import Motions, simulate

# 2026-01-01 00:00 UTC. A simulation has no date, and 0 cannot be the first stamp, because it means "unknown" in ROS.
EPOCH_NS = 1_767_225_600 * 10**9
REST_S = 2.0  # rest before the gait in a recorded run
BUS_VOLTAGE = 12.0  # V; determines the current in a recorded run


@dataclass(frozen=True)
class SimulatedRun:
    """Gait from rest: ``time`` (n,) in s since its onset, ``command`` (n,) u_cmd in m, ``motions`` at these times."""

    gait: Gait
    parameters: Parameters
    cycles: int
    time: Array
    command: Array
    motions: Motions

    def table(self) -> dict[str, Array]:
        """Return the columns by name; each name ends in the unit."""
        motions = self.motions
        return {
            "time_s": self.time,
            "length_change_m": motions.length - self.parameters.initial_length,
            "rear_position_m": motions.x1,
            "front_position_m": motions.x2,
            "rear_anchor_m": motions.rear_anchor,
            "front_anchor_m": motions.front_anchor,
            "cable_force_N": motions.cable_force,
            "power_W": motions.power,
            "energy_J": motions.energy,
        }

    @property
    def stamp(self) -> NDArray[np.int64]:
        """Stamps (n,) in ns since the epoch, with the arbitrary date EPOCH_NS."""
        return EPOCH_NS + round(REST_S * 1e9) + np.round(1e9 * self.time).astype(np.int64)

    def provenance(self) -> dict[str, str]:
        """Return the metadata that a bag with this run stores: the program, and the parameters of the simulation."""
        values = {f"parameter.{key}": repr(v) for key, v in self.parameters.as_dict().items()}
        return {"made_by": "worm_model simulate", **values}

    def twin_states(self) -> dict[str, NDArray[Any]]:
        """Return the fields of TwinState at the stamps."""
        motions, p = self.motions, self.parameters
        one = np.ones(self.time.size)
        return {
            "length_source": np.full(self.time.size, run.LengthSource.ESTIMATED),
            "initial_length": p.initial_length * one,
            "groove_phase": groove_phase(p) * one,
            "length": motions.length,
            "length_rate": motions.length_rate,
            "rear_position": motions.x1,
            "front_position": motions.x2,
            "rear_velocity": motions.v1,
            "front_velocity": motions.v2,
            "rear_anchor": motions.rear_anchor,
            "front_anchor": motions.front_anchor,
            "rear_groove": motions.rear_groove,
            "front_groove": motions.front_groove - front_groove(p),
            "cable_force": motions.cable_force,
            "rear_fin_force": motions.rear_force,
            "front_fin_force": motions.front_force,
            "power": motions.power,
            "energy": motions.energy,
        }

    def as_recorded(self) -> run.Run:
        """Return the recording of an ideal driver, camera and power sensor, with a rest before the gait."""
        length = self.parameters.initial_length
        step = self.time[1] - self.time[0]
        count = int(REST_S / step + 1e-9)

        def after_rest(values: Array) -> Array:
            return np.concatenate([np.full(count, values[0]), values])

        onset = int(self.stamp[0])
        early = onset - np.round(1e9 * step * np.arange(count, 0, -1)).astype(np.int64)
        stamp = np.concatenate([early, self.stamp])
        command = after_rest(self.command)
        change = after_rest(self.motions.length - length)
        power = np.concatenate([np.full(count, self.parameters.idle_power), self.motions.power])
        x1 = after_rest(self.motions.x1)
        commanded = run.LengthSamples(stamp, length + command, command)
        body = run.LengthSamples(stamp, length + change, change)
        current = power / BUS_VOLTAGE
        status = np.full(stamp.size, run.POWER_VALID)
        return run.Run(
            origin=EPOCH_NS,
            commanded=commanded,
            measured=body,
            tracker=run.TrackerSamples(stamp, x1, x1 + body.length),
            power=run.PowerSamples(stamp, status, np.full(stamp.size, BUS_VOLTAGE), current, power),
            gait_state=self._states(onset),
        )

    def _states(self, onset: int) -> run.GaitStates:
        """Return the driver's states at the start of the rest, at the start of each cycle, and at the end."""
        period = 1e9 * self.gait.period
        cycle = np.array([0, *range(1, self.cycles + 1), self.cycles])
        begins = [onset + round(k * period) for k in range(self.cycles + 1)]
        return run.GaitStates.of(
            self.gait,
            np.array([EPOCH_NS, *begins]),
            state=np.array(
                [run.Activity.RESTING, *[run.Activity.RUNNING] * self.cycles, run.Activity.IDLE]
            ),
            onset=np.full(cycle.size, onset),
            cycle=cycle,
            cycles=np.full(cycle.size, self.cycles),
            run=np.ones(cycle.size, np.int64),
        )


def simulated_run(gait: Gait, parameters: Parameters, cycles: int, rate: float) -> SimulatedRun:
    """Simulate a gait and sample it at a rate in Hz from its onset to its end."""
    trajectory = simulate(gait, parameters, cycles)
    time = np.arange(int(trajectory.duration * rate * (1.0 + 1e-12)) + 1) / rate
    time = np.minimum(time, trajectory.duration)
    return SimulatedRun(gait, parameters, cycles, time, gait.command(time), trajectory.at(time))
