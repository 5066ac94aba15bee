# SPDX-License-Identifier: Apache-2.0
"""Result of one cycle of the robot, as a frozen value that passes from the servo thread to other threads."""

from dataclasses import dataclass

from worm_driver.gait.gait_player import PlayerState
from worm_driver.servos.servo_state import ServoState


@dataclass(frozen=True)
class CycleSnapshot:
    """Result of one cycle. Times are monotonic, in s.

    Attributes:
        command_time: start of the cycle. If active, the goals are sent immediately after it.
        read_time: time at which the states of the servos were requested; command_time if the request failed.
        active: True if this driver has enabled the torque. A torque that an earlier driver left on does not count.
        homed: True if the length of the cable is known.
        player: state of the gait player.
        commanded: commanded length change of the cable, m; NaN if not active.
        cable: length change according to the encoders, m; NaN if a cable servo is silent, and before homing.
        servos: states in the order of the robot's servos; SILENT for a servo without a usable answer.
        alerts: ids of the servos whose last answer reported a hardware error.
    """

    command_time: float
    read_time: float
    active: bool
    player: PlayerState
    commanded: float
    cable: float
    servos: tuple[ServoState, ...]
    alerts: frozenset[int] = frozenset()
    homed: bool = False
