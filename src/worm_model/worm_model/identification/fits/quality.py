# SPDX-License-Identifier: Apache-2.0
"""Quality checks of runs: hidden markers, gaps, outliers, too few ridges, a body that did not follow its command.

The traverse is the part of a run until x1 has advanced by five pitches, see `locomotion.Traverse`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from worm_model.arrays import Array
from worm_model.errors import IdentificationError
from worm_model.identification.data.observed_run import SAME_PLACE, Recording
from worm_model.identification.fits.estimate import noise_of
from worm_model.identification.fits.locomotion import RIDGES, Traverse
from worm_model.identification.fits.measured_length import AVERAGED, MeasuredLength, moving_median

LONGEST_GAP = 1.0  # s; the interpolated length within a longer gap is uncertain
# Smallest ratio of the range of the measured lengths to that of the commanded ones, if the body follows
FOLLOWS = 0.4
POWER_GAP = 8.0  # shortest gap between power samples that is reported, in median intervals
# Largest change of the length from one cycle to the next: for `AVERAGED` samples, relative to the range of the command;
# for half a period, m. A missed groove of a compliant robot shows in less than half a period.
JUMP, SLIP = 0.15, 1.5e-3
REPEATS = 1e-3  # m, largest change of a command that repeats
FEWEST_POWER = 10  # smallest number of power samples during the traverse
POWER_SPAN = 0.9  # smallest share of the traverse's duration that the power samples must span


def follows_command(recording: Recording, length: MeasuredLength) -> str:
    """Return the reason to exclude a run whose body did not follow its command; empty if the body followed.

    Possible causes are a stuck servo, a slipped cable and a tracker that confuses its markers. Each of them changes the
    length from one cycle to the next. A compliant cable, a cable that cannot push or a slack that is taken up slowly
    do not: with them, too, the length repeats from the second half of the first cycle on.
    """
    after = (recording.camera_time > 0.0) & np.isfinite(recording.length)
    if not after.any():
        return f"{recording.name}: the tracker measured no length after the gait's onset"
    if length.explained:
        return ""
    settled = after & (recording.camera_time > 0.5 * recording.gait.period)
    realised = float(np.ptp(np.quantile(recording.length[settled], [0.02, 0.98])))
    commanded = float(np.ptp(recording.command))
    if realised < FOLLOWS * commanded:
        return (
            f"{recording.name}: the body length changed by {realised * 1e3:.1f} mm for a command of "
            f"{commanded * 1e3:.1f} mm. Check for a stuck servo, a slipped cable or confused markers"
        )
    time, change = _change_per_cycle(recording)
    rate = time.size / max(float(np.ptp(time)), recording.gait.period) if time.size else 1.0
    for window, limit in (
        (AVERAGED, JUMP * commanded),
        (int(0.5 * recording.gait.period * rate) + 1, max(SLIP, noise_of(recording.length))),
    ):
        astray = np.flatnonzero(np.abs(moving_median(change, window)) > limit)
        if astray.size:
            first = int(astray[0]) + min(window, time.size) // 2
            return (
                f"{recording.name}: at {time[first]:.1f} s after the onset the body length differs by "
                f"{change[first] * 1e3:+.1f} mm from that of the previous cycle. Check for a stuck servo, a slipped "
                "cable or confused markers"
            )
    return ""


def _change_per_cycle(recording: Recording) -> tuple[Array, Array]:
    """Return times (n,) in s and the change of the length since the previous cycle (n,) in m.

    Only times after which the slack is taken up, and at which the command repeats, are included.
    """
    period, time = recording.gait.period, recording.camera_time

    def change(times: Array, values: Array) -> Array:
        return np.interp(time, times, values) - np.interp(time - period, times, values)

    commanded = change(recording.command_time, recording.command)
    measured = change(time, recording.length)
    kept = (time > 1.5 * period) & (time <= recording.end) & np.isfinite(measured)
    kept &= np.abs(commanded) < REPEATS
    return time[kept], measured[kept]


def usable(
    recordings: Sequence[Recording], lengths: Sequence[MeasuredLength]
) -> tuple[list[int], list[str]]:
    """Return the indices of the usable runs and the reasons why the other runs are excluded."""
    reasons = [follows_command(r, m) for r, m in zip(recordings, lengths, strict=True)]
    kept = [index for index, reason in enumerate(reasons) if not reason]
    if not kept:
        raise IdentificationError(reasons[0])
    return kept, [f"{reason}; the run is excluded" for reason in reasons if reason]


def remarks(recording: Recording, length: MeasuredLength, traverse: Traverse) -> list[str]:
    """Return remarks on a run's data and how they were handled."""
    texts = []
    hidden = int(np.sum(~np.isfinite(recording.length)))
    gap = longest_gap(recording)
    if hidden or gap > 3.0 * float(np.median(np.diff(recording.camera_time))):
        texts.append(
            f"{hidden} camera samples with a hidden marker, longest gap {gap:.2f} s: x1 is compared where its marker "
            "is visible, and the run's actuation fit fills the gaps of the length"
        )
    if gap > LONGEST_GAP:
        texts.append(f"the length within the long gap of {gap:.1f} s is uncertain")
    outliers = int(np.sum(length.outliers))
    if outliers:
        texts.append(f"{outliers} lengths excluded as outliers")
    pauses = np.diff(recording.power_time)
    if pauses.size and pauses.max() > POWER_GAP * float(np.median(pauses)):
        texts.append(
            f"{pauses.max():.2f} s without a power sample: the power is interpolated linearly"
        )
    if not traverse.complete:
        reached = float(np.nanmax(np.abs(recording.x1)))
        texts.append(
            f"passed fewer than {RIDGES} ridges (x1 reached {reached * 1e3:.0f} mm): the whole run is used"
        )
    return [f"{recording.name}: {text}" for text in texts]


def starts_apart(recordings: Sequence[Recording]) -> list[str]:
    """Return a warning if the runs started in different grooves, otherwise an empty list.

    All stages of the identification assume that the runs started in the same grooves.
    """
    *_, last = ordered = sorted(recordings, key=lambda recording: recording.start)
    first = ordered[0]
    apart = last.start - first.start
    if apart <= SAME_PLACE:
        return []
    return [
        f"{first.name} and {last.name} start {apart * 1e3:.0f} mm apart in the camera's frame, but all runs "
        "must start in the same grooves, with straight fins. Put the robot back before each run, or check whether the "
        "camera was moved"
    ]


def power_missing(recording: Recording, traverse: Traverse) -> str:
    """Return the reason why the energy over a run's traverse is unknown; empty if it is known."""
    begin, end = max(0.0, float(traverse.length.time[0])), traverse.end
    time = recording.power_time
    times = time[(time >= begin) & (time <= end)]
    if times.size >= FEWEST_POWER and times[-1] - times[0] >= POWER_SPAN * (end - begin):
        return ""
    covered = f" from {times[0]:.1f} to {times[-1]:.1f} s" if times.size else ""
    return (
        f"{recording.name}: {times.size} power samples{covered} in the first {end:.1f} s, which are evaluated: the run "
        "is excluded from the estimation of c_b and α_P"
    )


def longest_gap(recording: Recording) -> float:
    """Return the longest time between two successive measured lengths, s; 0 with fewer than two."""
    times = recording.camera_time[np.isfinite(recording.length)]
    return float(np.diff(times).max()) if times.size > 1 else 0.0
