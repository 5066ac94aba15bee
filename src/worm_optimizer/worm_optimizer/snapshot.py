# SPDX-License-Identifier: Apache-2.0
"""What was last heard of a robot and its twin, as values that know no ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from worm_model.twin.records import Activity, LengthSource, ResidualRecord, StateRecord
from worm_model.twin.scene import Sighting


@dataclass(frozen=True)
class DriverWord:
    """The driver's last GaitState; ``stroke`` in m, 0: no gait; ``frequency`` in Hz; ``run`` 0 before the first.

    ``stamp_ns`` is that of the message, ``onset_ns`` that of the gait, 0 while there is none.
    """

    state: Activity
    homed: bool
    emergency_stop: bool
    run: int
    cycle: int
    cycles: int
    stroke: float
    frequency: float
    direction: int
    message: str
    stamp_ns: int = 0
    onset_ns: int = 0


@dataclass(frozen=True)
class Snapshot:
    """The newest of everything; None or NaN what has not come yet.

    A residual is NaN where nothing measures it. ``lengths`` in m by their source, ``power`` in W as measured.
    ``heard`` says when each topic was heard last (s, on the clock that the reader uses, too); topics that never were
    are missing in it. ``twin_age`` is how much older the twin's state is than the driver's command, in s of the
    robot's time. ``grooves`` are the twin's rear grooves of the last seconds: stamp in ns, groove since the onset.
    """

    driver: DriverWord | None = None
    twin: StateRecord | None = None
    residuals: ResidualRecord | None = None
    robot: Sighting = field(default_factory=Sighting)
    lengths: Mapping[LengthSource, float] = field(default_factory=dict)
    power: float = math.nan
    twin_age: float = math.nan
    heard: Mapping[str, float] = field(default_factory=dict)
    grooves: tuple[tuple[int, int], ...] = ()
