# SPDX-License-Identifier: Apache-2.0
"""One run as data of the identification: the command from the onset on, and measurements from the rest before it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from worm_model.arrays import Array
from worm_model.errors import IdentificationError
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import (
    PLAYING,
    POWER_VALID,
    Activity,
    GaitStates,
    LengthSamples,
    Run,
    Stamps,
    seconds,
)
from worm_model.simulation.actuation import resting_change
from worm_model.simulation.simulator import Locomotion

# ns before the onset that are read if the recording does not contain the beginning of the rest
LONGEST_REST = 3_000_000_000
FEWEST_SAMPLES = 20  # smallest number of samples of a topic
# m, largest distance between starts that count as the same place; about half the paper's clearance
SAME_PLACE = 4e-3
# m; the cable has reached a pretension if the command deviates from the pretension by at most this
TENSIONED = 5e-4
# ns that the body needs to come to rest after the cable has reached the pretension: five time constants of the paper's
# parameters. With its default settings, the driver begins the gait later than that.
TENSIONED_REST = 800_000_000
MOST_MISFIT = 1e-3  # m, largest median deviation of the commanded lengths from the recorded gait


@dataclass(frozen=True)
class Recording:
    """Data of one run.

    Times are in s since the onset, on the clock of each instrument. These clocks may differ by some milliseconds.

    Attributes:
        name, gait: name of the run and its gait.
        camera_time, x1, x2: s and m, shape (n,); NaN where a marker is hidden. Positions are relative to the rear
            module at rest before the onset, after a pretension has moved it.
        command_time, command: s and m, shape (m,): u_cmd from the onset on, beginning with its value at rest at time 0.
        power_time, power: s and W, shape (p,); empty if not recorded.
        sources: SHA-256 by file.
        date: UTC date of the first stamp, empty if unknown.
        remarks: remarks on excluded data and on assumptions.
        start: position (m) of the rear module in the camera's frame before the cable was tensioned. Runs with similar
            values began in the same grooves.
    """

    name: str
    gait: Gait
    camera_time: Array
    x1: Array
    x2: Array
    command_time: Array
    command: Array
    power_time: Array
    power: Array
    sources: Mapping[str, str] = field(default_factory=dict)
    date: str = ""
    remarks: tuple[str, ...] = ()
    start: float = 0.0

    @property
    def length(self) -> Array:
        """Measured body length x2 − x1 in m, NaN where a marker is hidden."""
        return self.x2 - self.x1

    @property
    def at_rest(self) -> NDArray[np.bool_]:
        """Mask of the camera samples before the onset with both markers visible."""
        return (self.camera_time < 0.0) & np.isfinite(self.length)

    @property
    def end(self) -> float:
        """Last time (s) that both camera and command cover."""
        return float(min(self.camera_time[-1], self.command_time[-1]))


def recordings_of(
    run: Run, name: str, sources: Mapping[str, str] | None = None, date: str = ""
) -> tuple[Recording, ...]:
    """Return the recordings of the first gait and of the later gaits that began within SAME_PLACE of the first.

    Gaits that began elsewhere are excluded, because their fins start bent by an unknown amount. Later gaits with
    unusable data are excluded as well. A remark reports each excluded gait. Raises `IdentificationError` if tracker,
    commanded lengths or gait states are missing, or if the first gait is unusable.
    """
    runs = run.gait_state.rows_of_runs()
    if not runs:
        raise IdentificationError(
            f"{name}: gait_state contains no gait; record one run per bag, from rest"
        )
    kept: list[Recording] = []
    remarks: list[str] = []
    for number, rows in enumerate(runs, 1):
        own = f"{name}_gait_{number}" if number > 1 else name
        try:
            recording = replace(
                _recording(run, int(rows[0]), own), sources=dict(sources or {}), date=date
            )
        except IdentificationError as error:
            if not kept:
                raise
            remarks.append(f"excluded: {error}")
            continue
        apart = recording.start - kept[0].start if kept else 0.0
        if abs(apart) <= SAME_PLACE:
            kept.append(recording)
        else:
            remarks.append(
                f"gait {number} ({1e3 * recording.gait.stroke:g} mm, {recording.gait.frequency:g} Hz) is excluded: "
                "it begins "
                f"{1e3 * apart:+.0f} mm from the first gait, with fins still bent by the previous gait"
            )
    return (replace(kept[0], remarks=tuple(remarks)), *kept[1:])


def _recording(run: Run, row: int, name: str) -> Recording:
    """Return the recording of the gait that begins with a ``row`` of the gait states."""
    states = run.gait_state
    gait = replace(states.gait(row), margin=0.0)
    onset = int(states.onset[row])
    first, last = _span(states, row)
    if gait.pretension > 0.0:
        first = max(first, _rest_under_pretension(run.commanded, gait, onset, first))

    def within(stamp: Stamps) -> NDArray[np.bool_]:
        return (stamp >= first) & (stamp <= last)

    commanded, tracked = within(run.commanded.stamp), within(run.tracker.stamp)
    commanded &= np.isfinite(run.commanded.length_change)
    _check_sizes(name, {"tracker": tracked, "body_length/commanded": commanded})
    powered = within(run.power.stamp) & (run.power.status == POWER_VALID)
    powered &= np.isfinite(run.power.power)
    command_time = seconds(run.commanded.stamp[commanded], onset)
    command = run.commanded.length_change[commanded]
    shift = _onset_shift(command_time, command, gait, name)
    playing = command_time > shift
    recording = Recording(
        name=name,
        gait=gait,
        camera_time=seconds(run.tracker.stamp[tracked], onset) - shift,
        x1=run.tracker.rear_position[tracked],
        x2=run.tracker.front_position[tracked],
        command_time=np.append(0.0, command_time[playing] - shift),
        command=np.append(0.0 - gait.pretension, command[playing]),
        power_time=seconds(run.power.stamp[powered], onset) - shift,
        power=run.power.power[powered],
    )
    return _counted_from_rest(recording)


def _check_sizes(name: str, samples: Mapping[str, NDArray[np.bool_]]) -> None:
    for topic, used in samples.items():
        size = int(used.sum())
        if size < FEWEST_SAMPLES:
            raise IdentificationError(
                f"{name}: only {size} samples of {topic} from the rest before the gait to its end, "
                f"{FEWEST_SAMPLES} are needed"
            )


def _span(states: GaitStates, row: int) -> tuple[int, int]:
    """Return two stamps: the beginning of the rest before the gait that begins with a row, and the end of this gait."""
    onset = int(states.onset[row])
    rests = states.stamp[(states.state == Activity.RESTING) & (states.stamp <= onset)]
    first = int(rests[-1]) if rests.size else onset - LONGEST_REST
    over = ~np.isin(states.state, PLAYING) & (states.stamp > onset)
    following = [states.stamp[rows[:1]] for rows in states.rows_of_runs() if rows[0] > row]
    ends = np.sort(np.concatenate([states.stamp[over], *following]))
    return first, int(ends[0]) if ends.size else np.iinfo(np.int64).max


def _rest_under_pretension(commanded: LengthSamples, gait: Gait, onset: int, first: int) -> int:
    """Return the stamp from which the body rests under a gait's pretension.

    The result is ``first`` if the command has the value of the pretension from the start of the recording on.
    """
    off = np.abs(commanded.length_change + gait.pretension) > TENSIONED
    before = commanded.stamp[off & (commanded.stamp <= onset)]
    return int(before.max()) + TENSIONED_REST if before.size else first


def _onset_shift(time: Array, command: Array, gait: Gait, name: str) -> float:
    """Return the delay (s) of the commanded lengths behind a gait that begins at the reported onset.

    Raises `IdentificationError` if the commanded lengths are not those of the gait.
    """

    def misfit(shift: Array) -> Array:
        return 1e3 * (command - gait.command(np.maximum(time - shift[0], 0.0)))

    played = time < time[-1] - 0.25 * gait.period  # the last commands may belong to the stop
    fit = least_squares(
        lambda shift: misfit(shift)[played], [0.0], x_scale=[0.01], loss="soft_l1", diff_step=1e-3
    )
    worst = float(np.median(np.abs(misfit(fit.x)[played]))) * 1e-3
    if worst > MOST_MISFIT or abs(fit.x[0]) > 0.25 * gait.period:
        raise IdentificationError(
            f"{name}: the commanded lengths of body_length are not the gait of {gait.stroke:g} m at "
            f"{gait.frequency:g} Hz in gait_state: one of the two topics is wrong"
        )
    return float(fit.x[0])


def _counted_from_rest(recording: Recording) -> Recording:
    """Return the recording with positions relative to the rear module's rest."""
    rest = recording.x1[recording.at_rest]
    if rest.size < 10:
        tensioned = (
            f" (from {TENSIONED_REST / 1e9:g} s after the cable reached the pretension; the driver's parameter "
            "rest_duration_s is the shortest rest)"
            if recording.gait.pretension > 0.0
            else ""
        )
        raise IdentificationError(
            f"{recording.name}: only {rest.size} camera samples show both markers in the rest before the gait"
            f"{tensioned}; keep the robot at rest for 2 s within sight of the camera"
        )
    middle = float(np.median(rest[np.abs(rest - np.median(rest)) < 5e-3]))
    zero = float(rest[np.abs(rest - middle) < 2e-3].mean())
    start = zero - _moved_by_pretension(recording)
    return replace(recording, x1=recording.x1 - zero, x2=recording.x2 - zero, start=start)


def _moved_by_pretension(recording: Recording) -> float:
    """Return the distance (m) by which the run's pretension would move the rear module of the paper's robot.

    The parameters of the recorded robot are not known yet. The resulting error is below a millimetre, which
    `SAME_PLACE` permits.
    """
    change = resting_change(recording.gait, PAPER)
    length = float(np.median(recording.length[recording.at_rest])) - change
    model = Locomotion(PAPER.replace(initial_length=length), recording.gait.direction)
    return model.x1(model.at_rest(length_change=change))
