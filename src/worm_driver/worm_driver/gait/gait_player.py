# SPDX-License-Identifier: Apache-2.0
"""State machine that computes the commands for the cable and the fins.

The phases of a run, and the phase without one:

- RETURNING: the cable returns to delta L = 0. The phase ends when the encoders show that it is there.
- FLIPPING: the fins are set, and the robot settles.
- RESTING: the robot is at rest, and idle power is sampled.
- RUNNING: the cycles, each from the point of rest (commanded contraction 0, or equal to the pretension) back
  to it.
- IDLE: no run is in progress, and nothing moves.

With a pretension, the cable is tensioned once the fins are set (FLIPPING -> TENSIONING -> FLIPPING). After the end of
such a run, the cable returns to delta L = 0 (RUNNING -> RETURNING -> IDLE).

A run that is cancelled in RETURNING or RUNNING passes through STOPPING, and ends at the next point of rest. A run that
is cancelled in another phase ends at once, and the cable returns to delta L = 0. `stop` holds the cable in the phase
HOLDING, `fault` in the phase FAULT. Times are monotonic, in s.
"""

import enum
import math
from dataclasses import dataclass, replace

from worm_driver.driver_errors import RejectedError
from worm_msgs.driver_file import DriverFile
from worm_msgs.gait import Gait

#: m, distance from delta L = 0 below which the cable is commanded to rest
REST_TOLERANCE = 1e-4


class Phase(enum.Enum):
    """Phase of the player."""

    IDLE = "idle"
    RETURNING = "returning to rest"
    FLIPPING = "setting the fins"
    TENSIONING = "tensioning the cable"
    RESTING = "resting"
    RUNNING = "running"
    STOPPING = "stopping at the next point of rest"
    HOLDING = "holding"
    FAULT = "fault"


class Ending(enum.Enum):
    """Kind of a run's end."""

    COMPLETED = "completed"
    CANCELLED = "cancelled"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class PlayedRun:
    """Run of a gait, and its progress.

    Attributes:
        number: number of the run, counted from 1 since the driver was configured.
        gait: the gait.
        cycles: requested number of cycles; `finish` lowers it.
        stop_cycle: number of the cycle after which the run stops, at most ``cycles``.
        rest_start: start of the rest, s; None before the rest.
        onset: start of the first cycle, s; None before the onset.
        end: end of the run, s; None during the run.
        ending: kind of the end; None during the run.
        reason: reason of an early end; empty otherwise.
    """

    number: int
    gait: Gait
    cycles: int
    stop_cycle: int
    rest_start: float | None = None
    onset: float | None = None
    end: float | None = None
    ending: Ending | None = None
    reason: str = ""

    def cycles_completed(self, now: float) -> int:
        """Return the number of complete cycles at a time (s), or at the end of a run that has ended."""
        if self.onset is None:
            return 0
        elapsed = (now if self.end is None else self.end) - self.onset
        return min(self.stop_cycle, math.floor(elapsed * self.gait.frequency + 1e-9))

    def cycle(self, now: float) -> int:
        """Return the number of the cycle at a time (s); the first cycle has the number 1. Return 0 before the onset."""
        if self.onset is None or now < self.onset:
            return 0
        return min(self.stop_cycle, math.floor((now - self.onset) * self.gait.frequency + 1e-9) + 1)


@dataclass(frozen=True)
class PlayerState:
    """State of the player between two steps.

    Attributes:
        phase: present phase.
        phase_start: start of the phase, s. The command that turns the fins sets it again. It keeps its value when
            `cancel` changes the phase to STOPPING.
        length_change: commanded length change, m. In a hold and in the return from it, that of the servo that is
            farthest from rest, see `Actuators.hold`.
        ramp_from: commanded length change from which the ramp of the phase starts, if the phase has one, m.
        ramp_done: fraction of the duration of this ramp that has passed, 0 to 1.
        direction: commanded direction of the fins, 1 or -1; 0 before the first run and after a hold.
        stepped: time of the last step, s.
        still_start: latest time at which a motion was commanded or a fin was not at its goal, s.
        run: present run; after its end, the last run.
        message: message for the operator, such as the reason of a hold or a fault.
    """

    phase: Phase = Phase.IDLE
    phase_start: float = 0.0
    length_change: float = 0.0
    ramp_from: float = 0.0
    ramp_done: float = 0.0
    direction: int = 0
    stepped: float = -math.inf
    still_start: float = -math.inf
    run: PlayedRun | None = None
    message: str = ""

    @property
    def active_run(self) -> PlayedRun | None:
        """Run that has not ended; None if there is none."""
        return self.run if self.run is not None and self.run.ending is None else None


@dataclass(frozen=True)
class Observation:
    """Observations on which the changes of the phase depend.

    Attributes:
        unset_fins: ids of the fin servos that have not reached their goals.
        idle_samples: number of valid power samples since the rest began.
        tracker_ready: True if the tracker sees the robot at rest, or if there is no tracker.
        at_rest: True if no cable is contracted according to the encoders.
    """

    unset_fins: tuple[int, ...]
    idle_samples: int
    tracker_ready: bool = True
    at_rest: bool = True


@dataclass(frozen=True)
class PlayerSettings:
    """Times and speeds of the phases, SI.

    Attributes:
        rest_duration: shortest rest before a gait, s.
        settle_time: time from the end of a motion to the start of the rest, in which the robot settles, s.
        rest_samples: number of valid power samples before the rest ends, unless rest_timeout expires.
        rest_timeout: longest rest, s. The gait then starts even if power samples are missing or the tracker has not
            seen the robot at rest.
        flip_timeout: longest motion of the fins, s. A longer motion is a fault.
        return_speed: peak cable speed of a return to rest and of the tensioning, m/s.
        longest_step: longest time by which a return to rest or the tensioning advances in one step, s. After a late
            step the cable does not catch up, because that would exceed return_speed.
    """

    rest_duration: float = DriverFile.rest_duration
    settle_time: float = 0.5
    rest_samples: int = 10
    rest_timeout: float = 3.0
    flip_timeout: float = 3.0
    return_speed: float = DriverFile.return_speed
    longest_step: float = 0.01


def start(state: PlayerState, now: float, gait: Gait, cycles: int) -> PlayerState:
    """Begin a run. If the cable is not at delta L = 0, for example after a hold, it first returns there."""
    run = state.active_run
    if run is not None:
        raise RejectedError(
            f"a gait is running already (cycle {run.cycle(now)} of {run.cycles}): cancel it or wait for its end"
        )
    if state.phase is Phase.FAULT:
        raise RejectedError(
            f"the driver is in fault ({state.message}): remove the cause, then deactivate and activate the driver"
        )
    number = 1 if state.run is None else state.run.number + 1
    state = replace(state, run=PlayedRun(number, gait, cycles, cycles), message="")
    return state if state.phase is Phase.RETURNING else _enter(state, Phase.RETURNING, now)


def finish(state: PlayerState, now: float) -> PlayerState:
    """Make the present cycle the last one of the run, and count the run as completed.

    Outside of RUNNING, return the state unchanged.
    """
    run = state.active_run
    if run is None or state.phase is not Phase.RUNNING:
        return state
    cycle = max(1, run.cycle(now))
    return replace(state, run=replace(run, cycles=cycle, stop_cycle=cycle))


def cancel(state: PlayerState, now: float, reason: str) -> PlayerState:
    """End the run: at its next point of rest in RETURNING and RUNNING, at once in any other phase.

    In STOPPING, return the state unchanged.
    """
    run = state.active_run
    if run is None or state.phase is Phase.STOPPING:
        return state
    if run.onset is not None:
        run = replace(run, stop_cycle=max(1, run.cycle(now)))
    run = replace(run, reason=reason)
    if state.phase is Phase.RETURNING or run.onset is not None:
        return replace(state, phase=Phase.STOPPING, run=run)
    return _come_to_rest(replace(state, run=run), now, Ending.CANCELLED, now)


def stop(state: PlayerState, now: float, reason: str) -> PlayerState:
    """Hold the cable at once. In HOLDING only the message changes, in FAULT nothing."""
    if state.phase is Phase.FAULT:
        return state
    if state.phase is Phase.HOLDING:
        return replace(state, message=reason)
    return _hold(state, now, Phase.HOLDING, Ending.STOPPED, reason)


def fault(state: PlayerState, now: float, reason: str) -> PlayerState:
    """Hold the cable at once, until the driver is activated again. A later fault does not replace the reason."""
    if state.phase is Phase.FAULT:
        return state
    return _hold(state, now, Phase.FAULT, Ending.FAILED, reason)


def return_to_rest(state: PlayerState, now: float, reason: str) -> PlayerState:
    """End the run at once, and begin to return the cable to delta L = 0."""
    if state.active_run is not None:
        state = _end(state, now, Ending.STOPPED, Phase.IDLE, reason)
    return _enter(replace(state, message=reason), Phase.RETURNING, now)


def at_rest(state: PlayerState) -> bool:
    """Return True in IDLE with the cable commanded to delta L = 0."""
    return state.phase is Phase.IDLE and abs(state.length_change) <= REST_TOLERANCE


def moving(state: PlayerState) -> bool:
    """Return True if the cable is commanded to move."""
    return state.phase in (Phase.RUNNING, Phase.STOPPING, Phase.RETURNING, Phase.TENSIONING)


def step(
    state: PlayerState, now: float, observation: Observation, settings: PlayerSettings
) -> PlayerState:
    """Return the next state, at a time (s). Call this function in every control cycle while the torque is on."""
    handler = _STEPS.get(state.phase)
    if handler is None:
        return state
    before, state = state, handler(state, now, observation, settings)
    state = replace(state, stepped=now)
    if moving(before) or state.direction != before.direction or observation.unset_fins:
        return replace(state, still_start=now)
    return state


def _returning(
    state: PlayerState, now: float, observation: Observation, settings: PlayerSettings
) -> PlayerState:
    state = _ramp(state, now, 0.0, settings)
    if state.length_change != 0.0 or not observation.at_rest:
        return state
    if state.active_run is None:
        return _enter(state, Phase.IDLE, now)
    return _flipping(_enter(state, Phase.FLIPPING, now), now, observation, settings)


def _tensioning(
    state: PlayerState, now: float, _: Observation, settings: PlayerSettings
) -> PlayerState:
    assert state.run is not None
    target = state.run.gait.point_of_rest
    state = _ramp(state, now, target, settings)
    return state if state.length_change != target else _enter(state, Phase.FLIPPING, now)


def _ramp(state: PlayerState, now: float, target: float, settings: PlayerSettings) -> PlayerState:
    """Return the state with the length change that a ramp to a target (m) has reached at the time ``now`` (s).

    The ramp is a half cosine, so that the speed of the cable has no steps. In each step it advances by the time since
    the previous step, at most ``longest_step``. So neither a late step nor another return speed makes the cable jump.
    """
    way = state.ramp_from - target
    if abs(way) <= REST_TOLERANCE:
        return replace(state, length_change=target)
    duration = math.pi / 2 * abs(way) / settings.return_speed
    elapsed = min(now - max(state.stepped, state.phase_start), settings.longest_step)
    done = state.ramp_done + elapsed / duration
    if done >= 1.0:
        return replace(state, length_change=target)
    value = target + way / 2 * (1.0 + math.cos(math.pi * done))
    return replace(state, length_change=value, ramp_done=done)


def _flipping(
    state: PlayerState, now: float, observation: Observation, settings: PlayerSettings
) -> PlayerState:
    run = state.run
    assert run is not None
    if state.direction != run.gait.direction:
        return replace(state, direction=run.gait.direction, phase_start=now)
    if not observation.unset_fins:
        if state.length_change != run.gait.point_of_rest:
            return _enter(state, Phase.TENSIONING, now)
        if now - state.still_start >= settings.settle_time:
            return _enter(replace(state, run=replace(run, rest_start=now)), Phase.RESTING, now)
    elif now - state.phase_start > settings.flip_timeout:
        fins = ", ".join(f"servo {number}" for number in observation.unset_fins)
        reason = (
            f"these fins did not reach their goals within {settings.flip_timeout:g} s: {fins}. Check whether something "
            "blocks them"
        )
        return fault(state, now, reason)
    return state


def _resting(
    state: PlayerState, now: float, observation: Observation, settings: PlayerSettings
) -> PlayerState:
    run = state.run
    assert run is not None
    rested = now - state.phase_start
    enough = rested >= settings.rest_duration and observation.idle_samples >= settings.rest_samples
    if not (enough and observation.tracker_ready) and rested < settings.rest_timeout:
        return state
    message = (
        ""
        if observation.tracker_ready
        else "the tracker did not see the robot at rest before the gait"
    )
    state = replace(state, run=replace(run, onset=now), message=message)
    return _enter(state, Phase.RUNNING, now)


def _running(
    state: PlayerState, now: float, observation: Observation, settings: PlayerSettings
) -> PlayerState:
    run = state.run
    assert run is not None
    if run.onset is None:  # The run was cancelled during the return to rest.
        state = _ramp(state, now, 0.0, settings)
        returns = state.length_change != 0.0 or not observation.at_rest
        return state if returns else _end(state, now, Ending.CANCELLED, Phase.IDLE)
    end = run.onset + run.stop_cycle / run.gait.frequency
    if now >= end:
        ending = Ending.CANCELLED if state.phase is Phase.STOPPING else Ending.COMPLETED
        state = replace(state, length_change=run.gait.point_of_rest)
        return _come_to_rest(state, now, ending, end)
    return replace(state, length_change=run.gait.length_change(now - run.onset))


_STEPS = {
    Phase.RETURNING: _returning,
    Phase.FLIPPING: _flipping,
    Phase.TENSIONING: _tensioning,
    Phase.RESTING: _resting,
    Phase.RUNNING: _running,
    Phase.STOPPING: _running,
}


def _enter(state: PlayerState, phase: Phase, now: float) -> PlayerState:
    return replace(
        state, phase=phase, phase_start=now, ramp_from=state.length_change, ramp_done=0.0
    )


def _end(
    state: PlayerState, now: float, ending: Ending, phase: Phase, reason: str = ""
) -> PlayerState:
    run = state.active_run
    if run is not None:
        run = replace(run, end=now, ending=ending, reason=reason or run.reason)
        state = replace(state, run=run)
    return replace(state, phase=phase, phase_start=now)


def _come_to_rest(state: PlayerState, now: float, ending: Ending, end: float) -> PlayerState:
    """End a run at the time ``end`` (s). If the cable is not at delta L = 0, begin to return it there."""
    state = _end(state, end, ending, Phase.IDLE)
    return _enter(state, Phase.RETURNING, now) if state.length_change else state


def _hold(state: PlayerState, now: float, phase: Phase, ending: Ending, reason: str) -> PlayerState:
    state = _end(state, now, ending, phase, reason)
    return replace(state, direction=0, message=reason)
