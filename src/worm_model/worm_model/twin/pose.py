# SPDX-License-Identifier: Apache-2.0
"""How the robot stands when a run starts: as the paper has it, or as the run before left it.

The first run starts with each module on its groove. Once a run has ended, the fins stay where they are: the
modules stand off their grooves by up to some millimetres, which another start would get wrong for the whole next
run. While the cable rests the body takes its initial length again, and fins that are turned for the other
direction find the nearest grooves.
"""

from __future__ import annotations

from dataclasses import dataclass

from worm_model.parameters import Parameters
from worm_model.simulation.simulator import Locomotion, LocomotionState, SimulationError
from worm_model.twin.twin_state import Pose, TwinState

RELAX_S = 1.0  # in which the body takes its initial length again, and as long to come to rest
TOLERANCE = 0.3  # of a pitch, that a robot which nobody touched may be off its place


@dataclass(frozen=True)
class Place:
    """A pose, and the position (m) of its rear anchor in the tracker's frame."""

    pose: Pose
    anchor: float

    @property
    def rear_position(self) -> float:
        """Of the rear module in the tracker's frame, m."""
        return self.anchor + self.pose.x1

    def agrees_with(self, position: float, pitch: float) -> bool:
        """Whether a robot seen at a position (m) stands like this, in whichever groove."""
        off = position - self.rear_position
        return abs(off - round(off / pitch) * pitch) <= TOLERANCE * pitch


def left_behind(
    state: TwinState, parameters: Parameters, length: float, direction: int
) -> Place | None:
    """Where the run before leaves the robot, at a length (m) at rest and with the fins set for a direction.

    None if there was no run. ``parameters`` are those of the run before.
    """
    if state.track is None or not state.run.start_ns:
        return None
    model, motion = Locomotion(parameters, state.run.direction), state.track.motion
    try:
        motion = _rest(model, motion, length)
        moved = state.anchors.grooves_at(state.track.stamp_ns) + motion.rear_groove
        x1 = model.x1(motion) - motion.rear_groove * parameters.pitch
        front = motion.front_groove - motion.rear_groove
        if direction != state.run.direction:
            model = Locomotion(parameters, direction)
            over, front = round(x1 / parameters.pitch), round((x1 + length) / parameters.pitch)
            moved, x1, front = moved + over, x1 - over * parameters.pitch, front - over
            change = length - parameters.initial_length
            x1 = model.x1(_rest(model, model.start(0.0, change, x1, front), length))
    except SimulationError:
        return None
    return Place(Pose(x1, front), state.run.origin + moved * parameters.pitch)


def _rest(model: Locomotion, motion: LocomotionState, length: float) -> LocomotionState:
    """The motion once the body has taken a length (m) and has come to rest."""
    change = length - model.parameters.initial_length
    times = [motion.time + RELAX_S, motion.time + 2.0 * RELAX_S]
    return model.follow(motion, times, [change, change])[0]
