# SPDX-License-Identifier: Apache-2.0
"""What one cycle of the robot yields: frozen values that are handed from the I/O thread to whoever wants them."""

import math
from dataclasses import dataclass

from worm_driver.gait.gait_player import PlayerState
from worm_driver.servos.encoding import from_raw, unpack_from
from worm_driver.servos.registers import COMMON, ServoModel

#: the block that is read in every cycle: Realtime Tick to Present Temperature, without a gap in any model
STATE_START = COMMON["realtime_tick"].address
STATE_SIZE = COMMON["present_temperature"].end - STATE_START


@dataclass(frozen=True)
class ServoState:
    """A servo's state in SI.

    Attributes:
        ticks: present position, raw.
        position: rad. velocity: rad/s.
        effort: A, or the ratio of the load where the servo measures no current.
        voltage: V. temperature: degC.
        tick: s, the servo's own clock.
    """

    ticks: int
    position: float
    velocity: float
    effort: float
    voltage: float
    temperature: float
    tick: float


#: stands for a servo that did not answer
SILENT = ServoState(0, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)


def decode(model: ServoModel, block: bytes) -> ServoState:
    """A servo's state from the block STATE_START, STATE_SIZE."""

    def value(name: str) -> float:
        return from_raw(model[name], unpack_from(model[name], block, STATE_START))

    position = model["present_position"]
    ticks = unpack_from(position, block, STATE_START)
    return ServoState(
        ticks=ticks,
        position=from_raw(position, ticks),
        velocity=value("present_velocity"),
        effort=value("present_current" if model.measures_current else "present_load"),
        voltage=value("present_input_voltage"),
        temperature=value("present_temperature"),
        tick=value("realtime_tick"),
    )


@dataclass(frozen=True)
class Snapshot:
    """One cycle. Times are monotonic, in s.

    Attributes:
        command_time: when the goals were sent.
        read_time: when the servos were asked for their state.
        active: torque is on.
        homed: the length of the cable is known.
        player: what is being played.
        commanded: m, change of length asked of the cable; NaN with the torque off.
        cable: m, change of length by the encoders; NaN without all of them, or before homing.
        servos: states in the order of the robot's servos; SILENT for one that did not answer.
        alerts: ids of the servos whose last answer told of a hardware error.
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
