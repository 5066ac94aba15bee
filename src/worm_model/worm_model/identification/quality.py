# SPDX-License-Identifier: Apache-2.0
"""What is wrong with a run, in words: hidden markers, gaps, outliers, too few ridges, a body that did not follow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.locomotion import RIDGES, Traverse
from worm_model.identification.measured_length import MeasuredLength
from worm_model.identification.observed_run import SAME_PLACE, Recording
from worm_model.identification.robust import noise_of

LONGEST_GAP = 1.0  # s without a length, which is bridged by the actuation model
FOLLOWS = 0.4  # of the commanded range, which a body that follows covers at least
POWER_GAP = 8.0  # usual intervals between power samples from which a pause is worth a word
ASTRAY = 10.0  # camera noises by which a body that follows departs from its actuation fit at most
LEAST_ASTRAY = 1.5e-3  # m
FEWEST_POWER = 10  # samples over the five ridges
POWER_SPAN = 0.9  # of the time over the five ridges, that the power sensor covers at least
AVERAGED = 9  # samples


def follows_command(recording: Recording, length: MeasuredLength) -> str:
    """Empty, or why a run must not be averaged with the others: its body did not follow the cable.

    A stuck servo, a slipped cable and a tracker that mixes up its markers look like this.
    """
    after = (recording.camera_time > 0.0) & np.isfinite(recording.length)
    if not after.any():
        return f"{recording.name}: the tracker saw no length after the gait's onset"
    realised = float(np.ptp(np.quantile(recording.length[after], [0.02, 0.98])))
    commanded = float(np.ptp(recording.command))
    if realised < FOLLOWS * commanded:
        return (
            f"{recording.name}: the body changed its length by {realised * 1e3:.1f} mm under a command of "
            f"{commanded * 1e3:.1f} mm: a stuck servo or a slipped cable"
        )
    present = np.isfinite(length.misfit)
    misfit = np.abs(length.misfit[present])
    window = min(AVERAGED, misfit.size)
    averaged = np.array(
        [np.median(misfit[k : k + window]) for k in range(misfit.size - window + 1)]
    )
    limit = max(ASTRAY * noise_of(recording.length), LEAST_ASTRAY)
    astray = np.flatnonzero(averaged > limit)
    if astray.size:
        time = float(recording.camera_time[present][astray[0] + window // 2])
        return (
            f"{recording.name}: from {time:.1f} s after the onset the body does not follow its command: a stuck "
            "servo or a slipped cable"
        )
    return ""


def usable(
    recordings: Sequence[Recording], lengths: Sequence[MeasuredLength]
) -> tuple[list[int], list[str]]:
    """(indices of the runs that are used, why the others are not).

    Raises `IdentificationError` if none is left.
    """
    reasons = [follows_command(r, m) for r, m in zip(recordings, lengths, strict=True)]
    kept = [index for index, reason in enumerate(reasons) if not reason]
    if not kept:
        raise IdentificationError(reasons[0])
    return kept, [f"{reason}; the run is left out" for reason in reasons if reason]


def remarks(recording: Recording, length: MeasuredLength, traverse: Traverse) -> list[str]:
    """What was seen in a run and how it was handled, in words."""
    texts = []
    hidden = int(np.sum(~np.isfinite(recording.length)))
    gap = longest_gap(recording)
    if hidden or gap > 3.0 * float(np.median(np.diff(recording.camera_time))):
        texts.append(
            f"{hidden} camera samples with a hidden marker, longest gap {gap:.2f} s: x1 is compared where it was "
            "seen, the length is bridged by the run's actuation fit"
        )
    if gap > LONGEST_GAP:
        texts.append(f"a gap of {gap:.1f} s is long: what happened in it is a guess")
    outliers = int(np.sum(length.outliers))
    if outliers:
        texts.append(f"{outliers} lengths left out as outliers")
    pauses = np.diff(recording.power_time)
    if pauses.size and pauses.max() > POWER_GAP * float(np.median(pauses)):
        texts.append(
            f"{pauses.max():.2f} s without a power sample: its energy is bridged by a straight line"
        )
    if not traverse.complete:
        reached = float(np.nanmax(np.abs(recording.x1)))
        texts.append(
            f"never reached {RIDGES} ridges (x1 came to {reached * 1e3:.0f} mm): the whole run is used"
        )
    return [f"{recording.name}: {text}" for text in texts]


def starts_apart(recordings: Sequence[Recording]) -> list[str]:
    """What is to be said of runs that did not begin in the same grooves, which all stages take for granted."""
    *_, last = ordered = sorted(recordings, key=lambda recording: recording.start)
    first = ordered[0]
    apart = last.start - first.start
    if apart <= SAME_PLACE:
        return []
    return [
        f"{first.name} and {last.name} begin {apart * 1e3:.0f} mm apart, by the camera: all runs are taken to begin in "
        "the same grooves, with straight fins; put the robot back before each (or was the camera moved?)"
    ]


def power_missing(recording: Recording, traverse: Traverse) -> str:
    """Empty, or why a run's energy over its five ridges is not known."""
    begin, end = max(0.0, float(traverse.length.time[0])), traverse.end
    time = recording.power_time
    times = time[(time >= begin) & (time <= end)]
    if times.size >= FEWEST_POWER and times[-1] - times[0] >= POWER_SPAN * (end - begin):
        return ""
    what = f"from {times[0]:.1f} to {times[-1]:.1f} s" if times.size else "nowhere"
    return (
        f"{recording.name}: the power sensor saw {times.size} samples, {what}, of the {end:.1f} s over five ridges: "
        "the "
        "run is left out of c_b and α_P"
    )


def longest_gap(recording: Recording) -> float:
    """Longest time without a length between the first and the last one, s."""
    times = recording.camera_time[np.isfinite(recording.length)]
    return float(np.diff(times).max()) if times.size > 1 else 0.0
