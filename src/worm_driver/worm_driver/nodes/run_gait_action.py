# SPDX-License-Identifier: Apache-2.0
"""Server of the action run_gait, with feedback and the metrics of each run.

A goal is accepted when its run has begun, and rejected otherwise. The reason of a rejection is logged and published on
run_gait/rejections, because the response has no field for a reason.
"""

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from rclpy.action import CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.node import Node
from rclpy.task import Future

from worm_driver.control.hardware import Hardware
from worm_driver.control.robot import CycleSnapshot
from worm_driver.driver_errors import DriverError, RejectedError
from worm_driver.gait.gait_metrics import RunMetrics, RunRecord, distance, run_metrics
from worm_driver.gait.gait_player import Ending, Phase, PlayedRun
from worm_driver.gait.run_end import (
    PERIOD,
    HeartbeatMonitor,
    RunEnd,
    is_near_cycle_end,
    makes_no_progress,
    shorter_timeout,
    unseen_cycle,
)
from worm_driver.nodes.driver_messages import Stamps, gait_from
from worm_driver.nodes.driver_parameters import HEARTBEAT
from worm_driver.nodes.goal_server import GoalServer
from worm_driver.power.ina219 import PowerSample
from worm_msgs.action import RunGait
from worm_msgs.goal_rejections import GoalRejections
from worm_msgs.msg import Heartbeat
from worm_msgs.robot_parameters import RobotParameters

#: s, shortest time between two log lines on rejected goals, of which hundreds may arrive in a second
_LOG_PERIOD = 0.1
#: s, time between two feedback messages
_FEEDBACK_PERIOD = 0.2
#: s, time after a run's end. The result is computed once a tracker sample from after this time has arrived
_TRACKER_AFTERWARDS = 0.3
#: s, time after a run's end at which the result is computed even without such a sample
_TRACKER_TIMEOUT = 1.0


@dataclass
class _Current:
    """Run in progress, and its goal.

    Attributes:
        goal_id: id of the goal.
        number: number of the run.
        done: future of the ended run, or of the reason why there is no result.
        record: measurements of the run.
        body: body of the robot that plays the run.
        end: requested end of the run.
        owner: monitor of the heartbeats of the client that sent the goal.
        goal: the goal, once rclpy has accepted it; None before.
        next_feedback: time before which no feedback is published, s.
        ended: the run after its end; None before.
        run: latest state of the run; None before the first snapshot.
        judged: number of the last cycle at whose end the tracker saw the robot.
        end_requested: True if the end of the run was requested.
    """

    goal_id: bytes
    number: int
    done: Future
    record: RunRecord
    body: RobotParameters
    end: RunEnd
    owner: HeartbeatMonitor
    goal: ServerGoalHandle | None = None
    next_feedback: float = -math.inf
    ended: PlayedRun | None = None
    run: PlayedRun | None = None
    judged: int = 0
    end_requested: bool = False


class RunGaitAction:
    """Server of run_gait on a node. Callbacks run in the node's executor thread unless noted.

    Args:
        node: node of the driver.
        stamps: source of the stamps.
        hardware: returns the open hardware; None if the driver is not configured.
        tracker_is_publishing: returns True if the tracker publishes.
    """

    def __init__(
        self,
        node: Node,
        stamps: Stamps,
        hardware: Callable[[], Hardware | None],
        tracker_is_publishing: Callable[[], bool],
    ):
        self._node = node
        self._hardware = hardware
        self._tracker_is_publishing = tracker_is_publishing
        # Only the last run is in progress. The earlier ones have ended and wait for tracker samples.
        self._runs: list[_Current] = []
        self._rejections = GoalRejections(node, "run_gait", stamps.now)
        self._server = GoalServer(
            node,
            RunGait,
            "run_gait",
            self._begin,
            self._on_rejected,
            self._execute,
            self._on_cancel,
        )
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(PERIOD, self._check_heartbeats, clock=steady)

    def on_position(self, time_s: float, rear_position: float) -> None:
        """Add a tracker sample (s monotonic, m) to the records of the runs."""
        if math.isfinite(rear_position):
            for current in self._runs:
                current.record.positions.append((time_s, rear_position))
                self._judge(current)

    def on_heartbeat(self, beat: Heartbeat) -> None:
        """Record a heartbeat of the client that sent a goal. Safe in any thread."""
        goal = bytes(beat.goal)
        for current in tuple(self._runs):
            if current.goal_id == goal:
                current.owner.record()

    def on_power(self, sample: PowerSample) -> None:
        """Add a power sample to the records of the runs."""
        for current in self._runs:
            current.record.power.append(sample)

    def on_snapshot(self, snapshot: CycleSnapshot) -> None:
        """Publish feedback, and end a goal whose run has ended."""
        run = snapshot.player.run
        for current in self._runs:
            if run is not None and run.number == current.number and run.ending is None:
                current.run = run
                self._publish_feedback(current, run, snapshot)
                self._end_unseen(current, run, snapshot.command_time)
            elif run is not None and run.number == current.number:
                current.ended = run
            if current.ended is not None and not current.done.done():
                self._end_when_seen(current, current.ended, snapshot.command_time)

    def stop(self) -> None:
        """Reject every goal that has not begun. Safe in any thread; call it before the robot is stopped."""
        self._server.stop()

    @property
    def busy(self) -> bool:
        """True while a goal has no result."""
        return bool(self._runs)

    def abandon(self, reason: str) -> None:
        """End the goals of all runs, because the robot was closed."""
        for current in self._runs:
            if not current.done.done():
                current.done.set_result(current.ended or reason)

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        hardware = self._hardware()
        if hardware is not None and self._runs and self._runs[-1].goal_id == _id(goal):
            hardware.loop.submit(hardware.robot.cancel, lifetime=math.inf)
        return CancelResponse.ACCEPT

    def _judge(self, current: _Current) -> None:
        """End a run of given grooves or distance if the latest tracker sample shows their end or no progress."""
        run, hardware = current.run, self._hardware()
        if run is None or run.onset is None or not is_near_cycle_end(run, current.record):
            return
        current.judged = run.cycle(current.record.positions[-1][0])
        if hardware is None or not current.end.needs_tracker or current.end_requested:
            return
        if current.end.is_reached(run, current.record, current.body.pitch):
            current.end_requested = True
            hardware.loop.submit(hardware.robot.finish, lifetime=math.inf)
        elif math.isnan(distance(run, current.record)):
            self._end_early(current, "ended, as the tracker did not see the robot at the onset")
        elif makes_no_progress(run, current.record, current.body.pitch):
            self._end_early(current, "ended, as the robot gains no groove with this gait")

    def _end_unseen(self, current: _Current, run: PlayedRun, now: float) -> None:
        """End a run of given grooves or distance if the tracker did not see the end of its last cycle."""
        cycle = unseen_cycle(run, current.judged, now) if current.end.needs_tracker else 0
        if cycle:
            self._end_early(
                current, f"ended, as the tracker did not see the robot at the end of cycle {cycle}"
            )

    def _check_heartbeats(self) -> None:
        """End the runs whose heartbeat timeout has expired."""
        now = time.monotonic()
        for current in self._runs:
            if current.owner.is_silent(now) and current.ended is None:
                timeout = current.owner.timeout
                self._end_early(current, f"ended, as no heartbeat arrived for {timeout:g} s")

    def _end_early(self, current: _Current, reason: str) -> None:
        """End a run at its next point of rest. Later calls have no effect."""
        hardware = self._hardware()
        if hardware is None or current.end_requested:
            return
        current.end_requested = True
        self._node.get_logger().warning(f"run {current.number} {reason}")
        hardware.loop.submit(lambda now: hardware.robot.cancel(now, reason), lifetime=math.inf)

    def _on_rejected(self, goal_id: bytes, reason: str) -> None:
        """Report why a goal is rejected. Safe in any thread."""
        self._node.get_logger().warning(
            f"gait rejected: {reason}", throttle_duration_sec=_LOG_PERIOD
        )
        self._rejections.publish(goal_id, reason)

    async def _execute(self, goal: ServerGoalHandle) -> RunGait.Result:
        """Wait for the end of the run that `_begin` started, and return its result."""
        current = next(each for each in self._runs if each.goal_id == _id(goal))
        current.goal = goal
        hardware = self._hardware()
        if goal.is_cancel_requested and hardware is not None:  # requested before this callback ran
            hardware.loop.submit(hardware.robot.cancel, lifetime=math.inf)
        outcome = await current.done
        self._runs.remove(current)
        return self._finish(goal, current, outcome)

    def _begin(self, goal_id: bytes, request: RunGait.Goal, stops: int) -> None:
        """Begin the run of a goal; ``stops`` is the number of stops before its arrival. Raises DriverError."""
        hardware = self._hardware()
        if hardware is None:
            raise DriverError("the driver is not configured: configure and activate it first")
        gait = gait_from(request.gait)
        end = RunEnd(request.cycles, request.grooves, request.distance)
        cycles = end.most_cycles(gait, hardware.robot.limits)
        if end.needs_tracker and not self._tracker_is_publishing():
            raise DriverError(
                "a run by grooves or distance needs the topic tracker, but no samples arrive: start the tracker"
            )
        owner = HeartbeatMonitor(self._heartbeat_timeout(request.heartbeat), time.monotonic())

        def start(now: float) -> int:
            if self._server.stops != stops:
                raise RejectedError("a stop followed this goal: send the goal again")
            return hardware.robot.start(now, gait, cycles)

        number = hardware.loop.run(start, undo=hardware.robot.cancel)
        body = hardware.settings.body
        self._runs.append(_Current(goal_id, number, Future(), RunRecord(), body, end, owner))

    def _heartbeat_timeout(self, requested: float) -> float:
        """Return the heartbeat timeout of a run, s. Raises RejectedError."""
        if not (math.isfinite(requested) and requested >= 0.0):
            raise RejectedError(f"heartbeat is {requested:g} s; it must be 0 s or longer")
        required: float = self._node.get_parameter(HEARTBEAT).value
        return shorter_timeout(requested, required)

    def _finish(
        self, goal: ServerGoalHandle, current: _Current, outcome: PlayedRun | str
    ) -> RunGait.Result:
        if isinstance(outcome, str):
            goal.abort()
            return _no_result(outcome)
        metrics = run_metrics(outcome, current.record, current.body)
        result = _result(outcome, metrics, current.body.pitch)
        if outcome.ending is Ending.COMPLETED:
            goal.succeed()
        elif outcome.ending is Ending.CANCELLED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        self._node.get_logger().info(f"run {outcome.number}: {result.message}")
        return result

    def _publish_feedback(self, current: _Current, run: PlayedRun, snapshot: CycleSnapshot) -> None:
        now = snapshot.command_time
        if current.goal is None or now < current.next_feedback:
            return
        current.next_feedback = now + _FEEDBACK_PERIOD
        record = current.record
        travelled = distance(run, record)
        current.goal.publish_feedback(
            RunGait.Feedback(
                cycle=run.cycle(now),
                elapsed=_elapsed(run, snapshot),
                grooves=travelled / current.body.pitch,
                distance=travelled,
                power=record.latest_power(),
            )
        )

    @staticmethod
    def _end_when_seen(current: _Current, run: PlayedRun, now: float) -> None:
        """End a goal once the tracker samples extend beyond the run's end, or after the timeout.

        Without any tracker sample, end the goal at once.
        """
        assert run.end is not None
        positions = current.record.positions
        complete = not positions or positions[-1][0] >= run.end + _TRACKER_AFTERWARDS
        if complete or now > run.end + _TRACKER_TIMEOUT:
            current.done.set_result(run)


def _id(goal: ServerGoalHandle) -> bytes:
    return bytes(goal.goal_id.uuid)


def _elapsed(run: PlayedRun, snapshot: CycleSnapshot) -> float:
    """Return the time (s) since the onset. Before the onset, return the negated duration of the rest so far."""
    if run.onset is not None:
        return snapshot.command_time - run.onset
    resting = snapshot.player.phase is Phase.RESTING
    return -(snapshot.command_time - snapshot.player.phase_start) if resting else -0.0


def _result(run: PlayedRun, measured: RunMetrics, pitch: float) -> RunGait.Result:
    endings = {
        Ending.COMPLETED: f"completed {measured.cycles_completed} cycles",
        Ending.CANCELLED: f"{run.reason}, at rest after {measured.cycles_completed} cycles",
        Ending.STOPPED: f"stopped: {run.reason}",
        Ending.FAILED: f"fault: {run.reason}",
        None: "unfinished",
    }
    metrics = asdict(measured)
    reasons = metrics.pop("reasons")
    return RunGait.Result(
        success=run.ending is Ending.COMPLETED,
        message="; ".join((endings[run.ending], *reasons)),
        grooves=measured.distance / pitch,
        **metrics,
    )


def _no_result(message: str) -> RunGait.Result:
    nan = math.nan
    names = ("grooves", "distance", "speed", "power", "cost_of_transport", "idle_power")
    return RunGait.Result(message=message, **dict.fromkeys(names, nan))
