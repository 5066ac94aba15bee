# SPDX-License-Identifier: Apache-2.0
"""Settings of the twin. The node declares one parameter for each."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.parameter_rows import ParameterRow

PARAMETER_FILE = "parameter_file"
PUBLISH_TF = "publish_tf"


def _row(default: float, low: float, high: float, description: str) -> float:
    """Return a field with a default; its metadata contain range and description."""
    metadata = {"low": low, "high": high, "description": description}
    return dataclasses.field(default=default, metadata=metadata)


@dataclass(frozen=True)
class TwinSettings:
    """Settings of the twin; times in s, lengths in m, powers in W. Raises ValueError for a value out of range."""

    delay_s: float = _row(
        0.25,
        0.02,
        2.0,
        "a sample that is older than the newest by more than this when it arrives is excluded",
    )
    measured_stale_s: float = _row(
        0.2,
        0.01,
        10.0,
        "between measured lengths further apart than this, the length follows from the command",
    )
    pause_s: float = _row(
        1.0, 0.05, 60.0, "a longer time without measured lengths and commands is reported as a gap"
    )
    jump_back_s: float = _row(
        1.0,
        0.1,
        60.0,
        "late samples older than the newest by more than this show a jump of the clock",
    )
    hold_ahead_s: float = _row(
        1.0,
        0.1,
        60.0,
        "a sample ahead of the newest by more than this is held until others confirm it",
    )
    jump_ahead_s: float = _row(
        60.0,
        1.0,
        86400.0,
        "held samples that are confirmed further ahead than this show a jump of the clock",
    )
    # Shorter than the driver's period of 10 ms by more than the period's jitter, so that each command yields a state.
    output_period_s: float = _row(
        0.008, 0.0, 1.0, "shortest interval of published states and of estimated lengths"
    )
    rest_s: float = _row(
        1.0, 0.1, 10.0, "time before the onset over which rest pose and initial length are averaged"
    )
    smoothing_s: float = _row(
        0.15,
        0.02,
        1.0,
        "half the time over which a parabola is fitted to measured lengths for their rate",
    )
    position_scale_m: float = _row(0.003, 1e-5, 0.1, "usual size of a position residual")
    length_scale_m: float = _row(0.002, 1e-5, 0.1, "usual size of a length residual")
    power_scale_w: float = _row(0.6, 1e-3, 100.0, "usual size of a power residual")
    tracker_gate_m: float = _row(
        0.05,
        0.005,
        1.0,
        "a position that jumps by more than this plus 0.15 m/s times the elapsed time is rejected",
    )
    tracker_moved_s: float = _row(
        0.5,
        0.05,
        60.0,
        "if rejected positions agree with each other for this long, the tracker was moved",
    )

    def __post_init__(self) -> None:
        for row in dataclasses.fields(self):
            check(row, getattr(self, row.name))


def check(row: dataclasses.Field[Any], value: float) -> None:
    """Raise ValueError if the value of a setting is outside of its range."""
    low, high = row.metadata["low"], row.metadata["high"]
    if not low <= value <= high:
        raise ValueError(f"{row.name}: {value} is not between {low:g} and {high:g}")


DEFAULTS = TwinSettings()


def rows() -> list[ParameterRow]:
    """Return the declarations of all ROS parameters of the node."""
    file = ParameterRow(
        PARAMETER_FILE, "", "Parameter file (YAML) of the model; empty: the paper's values."
    )
    frames = ParameterRow(
        PUBLISH_TF, True, "Publish the transform from odom to base_link; needs tf2_msgs."
    )
    settings = dataclasses.fields(TwinSettings)
    return [
        file,
        frames,
        *(
            ParameterRow(name, 0.0, f"{row['meaning']}, {row['unit']}", row["low"], row["high"])
            for name, row in CONDITION_ROWS.items()
        ),
        *(ParameterRow(row.name, row.default, **row.metadata) for row in settings),
    ]
