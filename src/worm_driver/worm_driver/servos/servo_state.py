# SPDX-License-Identifier: Apache-2.0
"""State of a servo, decoded from the block of registers that is read in every cycle."""

import math
from dataclasses import dataclass

from worm_driver.servos.registers import COMMON, ServoModel

#: Block that is read in every cycle: Realtime Tick to Present Temperature. No model has a gap in this range.
STATE_START = COMMON["realtime_tick"].address
STATE_SIZE = COMMON["present_temperature"].end - STATE_START


@dataclass(frozen=True)
class ServoState:
    """State of a servo, in SI units.

    Attributes:
        ticks: present position, raw.
        position: present position, rad.
        velocity: present velocity, rad/s.
        effort: current, A; for a servo that measures no current, the load as a ratio of its maximum.
        voltage: supply voltage, V.
        temperature: temperature, degC.
        tick: time of the servo's own clock (realtime_tick), s.
        trajectory: present point of the servo's profile (position_trajectory), raw. The servo controls its position to
            this point. Under a load it remains behind it.
    """

    ticks: int
    position: float
    velocity: float
    effort: float
    voltage: float
    temperature: float
    tick: float
    trajectory: int = 0


#: State of a servo without a usable answer.
SILENT = ServoState(0, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)


def decode(model: ServoModel, block: bytes) -> ServoState:
    """Return a servo's state from its block of STATE_SIZE bytes at address STATE_START."""

    def value(name: str) -> float:
        return model[name].from_raw(model[name].unpack_from(block, STATE_START))

    position = model["present_position"]
    ticks = position.unpack_from(block, STATE_START)
    return ServoState(
        ticks=ticks,
        position=position.from_raw(ticks),
        velocity=value("present_velocity"),
        effort=value("present_current" if model.measures_current else "present_load"),
        voltage=value("present_input_voltage"),
        temperature=value("present_temperature"),
        tick=value("realtime_tick"),
        trajectory=model["position_trajectory"].unpack_from(block, STATE_START),
    )
