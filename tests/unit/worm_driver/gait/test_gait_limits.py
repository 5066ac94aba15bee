# SPDX-License-Identifier: Apache-2.0
import dataclasses
import math
import re

import pytest

from worm_driver.driver_errors import RejectedError
from worm_driver.gait.gait_limits import GaitLimits
from worm_driver.nodes.driver_messages import gait_from
from worm_msgs.gait import Gait, Profile
from worm_msgs.msg import Gait as GaitMessage

LIMITS = GaitLimits(max_stroke=0.09, max_frequency=0.4, max_cable_speed=0.1)


@pytest.mark.parametrize(
    ("values", "cycles", "message"),
    [
        ((math.nan, 0.2, {}), 5, "stroke: nan"),
        ((0.0901, 0.2, {}), 5, "limits.max_stroke_m"),
        ((0.01, 0.41, {}), 5, "limits.max_frequency_hz"),
        ((0.07, 0.2, {"direction": 0}), 5, "direction: 0 is neither 1"),
        ((0.07, 1e-300, {}), 5, "frequency 1e-300 Hz is outside 0.02 to 0.4"),
        ((1e-300, 0.2, {}), 5, "stroke 1e-300 m is outside 0.001 to 0.09"),
        ((0.07, 0.1, {}), 1000, "take 10000 s; a run may take 7200 s: request at most 720 cycles"),
        ((0.07, 0.2, {"pretension": 0.021}), 5, "contract the body by 0.091 m; the limit is 0.09"),
        ((0.07, 0.2, {"contraction_share": 0.2}), 5, "0.1100 m/s; the limit is 0.1000"),
        ((0.07, 0.2, {"contraction_share": 0.8}), 5, "frequency is at most 0.0127 m/s"),
        ((0.08, 0.4, {"profile": 1, "ramp_share": 0.5}), 5, "0.1280 m/s"),
        ((0.07, 0.2, {}), 0, "cycles must be 1 to"),
        ((0.07, 0.2, {}), 10**6, "cycles must be 1 to"),
        ((0.09, 0.4, {}), 5, "0.1131 m/s; the limit is 0.1000"),
    ],
)
def test_a_gait_beyond_the_limits_is_rejected_with_the_reason(values, cycles, message):
    stroke, frequency, others = values
    changes = {"stroke": stroke, "frequency": frequency, **others}
    gait = GaitMessage(**dataclasses.asdict(Gait(0.07, 0.2)) | changes)
    with pytest.raises(RejectedError, match=re.escape(message)):
        LIMITS.check(gait_from(gait), cycles)


@pytest.mark.parametrize(
    "gait",
    [
        Gait(0.07, 0.2),
        Gait(0.08, 0.2, pretension=0.01),
        Gait(0.09, 0.4, profile=Profile.TRAPEZOID, ramp_share=0.1),
    ],
)
def test_what_the_robot_can_play(gait):
    LIMITS.check(gait, 5)
