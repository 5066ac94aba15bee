# SPDX-License-Identifier: Apache-2.0
"""Settings of the twin, and the parameters of its node."""

from __future__ import annotations

from typing import NamedTuple

from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.parameter_rows import ParameterRow

PARAMETER_FILE = "parameter_file"
PUBLISH_TF = "publish_tf"


class TwinSettings(NamedTuple):
    """Settings of the twin that depend on the instruments of a robot.

    A sample that is older than the newest by more than ``delay_s`` (s) when it arrives is excluded. The scales are the
    usual sizes of the residuals, in the SI unit of their quantity.
    """

    delay_s: float = 0.25
    position_scale_m: float = 0.003
    length_scale_m: float = 0.002
    power_scale_w: float = 0.6


DEFAULTS = TwinSettings()


def rows() -> list[ParameterRow]:
    """Return the declarations of all ROS parameters of the node."""
    return [
        ParameterRow(
            PARAMETER_FILE, "", "Parameter file (YAML) of the model; empty: the paper's values."
        ),
        ParameterRow(
            PUBLISH_TF, True, "Publish the transform from odom to base_link; needs tf2_msgs."
        ),
        *(
            ParameterRow(name, 0.0, f"{row['meaning']}, {row['unit']}", row["low"], row["high"])
            for name, row in CONDITION_ROWS.items()
        ),
        ParameterRow(
            "delay_s",
            DEFAULTS.delay_s,
            "a sample that is older than the newest by more than this when it arrives is excluded",
            0.02,
            2.0,
        ),
        *(
            ParameterRow(
                f"{name}_scale_{unit}", usual, f"usual size of a {name} residual", low, high
            )
            for name, unit, usual, low, high in (
                ("position", "m", DEFAULTS.position_scale_m, 1e-5, 0.1),
                ("length", "m", DEFAULTS.length_scale_m, 1e-5, 0.1),
                ("power", "w", DEFAULTS.power_scale_w, 1e-3, 100.0),
            )
        ),
    ]
