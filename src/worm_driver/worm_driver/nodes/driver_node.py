# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node ``driver``: ROS on one side, the robot's loop on the other, nothing of its own in between.

configure opens and checks everything, activate enables the torque; deactivate, cleanup, shutdown, SIGINT, SIGTERM and
an escaped exception bring the gait to rest and release the servos.
"""

import math
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from traceback import format_exception
from typing import TypeVar

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.clock import Clock
from worm_driver.control.diagnostics import network_report, offline_report, release_report
from worm_driver.control.emergency import EmergencyLatch, state_folder
from worm_driver.control.hardware import Hardware
from worm_driver.control.telemetry import Snapshot
from worm_driver.errors import ConfigurationError, DriverError, ReleaseError, StoppedError
from worm_driver.gait.gait_player import Phase, PlayerState
from worm_driver.gait.stillness import Stillness
from worm_driver.nodes import driver_messages, driver_parameters
from worm_driver.nodes.driver_messages import ClockPair
from worm_driver.nodes.impossible_transitions import refuse_impossible_transitions
from worm_driver.nodes.run_gait_action import RunGaitAction
from worm_driver.nodes.side_node import SideNode
from worm_msgs import network
from worm_msgs.msg import BodyLength, GaitState, Heartbeat, Power, Tracker
from worm_msgs.node_command import declare, run_node
from worm_msgs.ros_process import Ending, spare_pauses

T = TypeVar("T")

#: s, how long the interpreter lets a thread run before another may; the default of 5 ms would be half a cycle
_SWITCH_INTERVAL = 0.0005

#: s, how old the latest tracker sample may be when a gait starts, and how long the first one may take
_FRESH = 0.2
_DISCOVERY = 5.0

#: s, in which the servos must have been enabled, homed, or released
_ACTIVATION = 5.0
_SERVICE = 10.0
_LETTING_GO = 5.0

#: s between two looks at what the threads of the hardware have left: fewer wake-ups than cycles, as each costs the
#: servo thread the interpreter for a while
_PUBLISH_PERIOD = 0.04

_DELIVERY = Duration(seconds=0.5)
#: s, in which a goal's result must have been made, and for which it has to leave: DDS acknowledges no answer
_ANSWERS = 1.0
_LINGER = 0.3

#: reliable; deep enough for what piles up while the executor's thread waits for a processor
_TELEMETRY = QoSProfile(depth=200)
#: no request is dropped, however many wait: whoever calls stop gets an answer
_EVERY_CALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: a user may change history, depth and reliability: qos_overrides./worm/power.publisher.reliability
_OPEN = QoSOverridingOptions.with_default_policies()
#: matches every publisher, also one that promises nothing
_ANYBODY = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class DriverNode(LifecycleNode):
    """See the module."""

    def __init__(self) -> None:
        super().__init__("driver")
        declare(self, driver_parameters.rows)
        self._reach = network.reach(os.environ, get_rmw_implementation_identifier())
        self._hardware: Hardware | None = None
        self._latest: Snapshot | None = None
        self._shown: tuple[object, ...] | None = None
        self._faulty = False
        self._failure: Exception | None = None
        self._clocks: ClockPair | None = None
        self._robot_clock: Clock | None = None  # stays after a clean-up, so that stamps go on
        self._born = time.monotonic()
        self._tracked = -math.inf
        self._stillness = Stillness()
        self._joint_states = self.create_publisher(
            JointState, "joint_states", _TELEMETRY, qos_overriding_options=_OPEN
        )
        self._commanded = self.create_publisher(
            BodyLength, "body_length/commanded", _TELEMETRY, qos_overriding_options=_OPEN
        )
        self._cable = self.create_publisher(
            BodyLength, "body_length/cable", _TELEMETRY, qos_overriding_options=_OPEN
        )
        self._power = self.create_publisher(
            Power, "power", _TELEMETRY, qos_overriding_options=_OPEN
        )
        self._gait_state = self.create_publisher(GaitState, "gait_state", _LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._emergency = EmergencyLatch(state_folder(os.environ))
        self._adopt_emergency()
        self._action = RunGaitAction(self, lambda: self._hardware, self._sees_robot)
        self.create_subscription(Tracker, "tracker", self._on_tracker, 100)
        self._side = SideNode(self, "stop")
        self._stop = self._side.node.create_service(
            Trigger, "stop", self._on_stop, qos_profile=_EVERY_CALL
        )
        self._side.node.create_subscription(Heartbeat, "heartbeat", self._action.on_heartbeat, 100)
        self._listen_for_emergencies()
        self._side.start()
        self.create_service(Trigger, "home", self._on_home)
        self.create_service(Trigger, "reboot", self._on_reboot)
        refuse_impossible_transitions(self)
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_PUBLISH_PERIOD, self._publish, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self._show_inactive("not configured")

    # --- parameters ----------------------------------------------------------------------------

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """What cannot take effect is refused while the robot is open."""
        fixed = driver_parameters.fixed(parameters)
        if self._hardware is None or not fixed:
            return SetParametersResult(successful=True)
        reason = f"{', '.join(fixed)}: takes effect at configure; deactivate and clean up the driver first"
        return SetParametersResult(successful=False, reason=reason)

    def _take_parameters(self, _: Sequence[Parameter]) -> None:
        """What takes effect at once does."""
        if self._hardware is None:
            return
        said = self._hardware.take(driver_parameters.settings(self))
        if said:
            self.get_logger().warning(said)
        self.get_logger().info(self._hardware.rest_line())

    # --- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Opens and checks everything; FAILURE, with the reason in the log and the diagnostics, if it cannot."""
        try:
            settings = driver_parameters.settings(self)
            self._adopt_emergency()
            self._hardware = Hardware(settings, self._tracker_ready, self._emergency.why_not_start)
            self._robot_clock = self._hardware.clock
        except Exception as error:  # noqa: BLE001 (rclpy would drop it without a word)
            return self._failed("configure", error)
        self._failure = None
        for line in self._hardware.description():
            self.get_logger().info(line)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enables the torque."""
        try:
            self._activate()
        except Exception as error:  # noqa: BLE001 (as above)
            return self._failed("activate", error)
        self._failure = None
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brings the gait to rest and releases the servos.

        FAILURE where a stop came on the way: the robot holds. ERROR, which closes everything, where a servo does not
        say that its torque is off, or the servo bus thread does not respond.
        """
        try:
            self._release()
        except StoppedError as error:
            return self._failed("deactivate", error)
        except Exception as error:  # noqa: BLE001 (as above)
            self._failed("deactivate", error)
            return TransitionCallbackReturn.ERROR
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Closes everything."""
        self.close("the driver is cleaned up")
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brings the gait to rest, releases the servos and closes everything; FAILURE if one may have its torque."""
        if self.close("the driver shuts down"):
            return TransitionCallbackReturn.FAILURE
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Releases and closes everything, so that the driver can be configured again."""
        self.close(f"a transition failed: {self._failure}")
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def close(self, reason: str) -> list[str]:
        """Brings the robot to rest, releases and closes it; needs no ROS, and is harmless when nothing is open.

        Returns what failed, in words: a servo may still have its torque.
        """
        hardware = self._hardware
        if hardware is None:
            return []
        problems = hardware.close(reason, self._publish)
        self._hardware = self._latest = None
        self._tracked = -math.inf  # another robot's clock may come
        for problem in problems:
            self.get_logger().error(f"on release: {problem}")
        if self.context.ok():
            self._publish_all(hardware)
            self._action.abandon(reason)
            self._show_inactive("; ".join((reason, *problems)))
            self._deliver()
        return problems

    def _deliver(self) -> None:
        """Waits until those who listen have the last words, for they are lost with the node."""
        for publisher in (self._joint_states, self._cable, self._power, self._gait_state):
            publisher.wait_for_all_acked(_DELIVERY)

    def answer_goals(self, executor: SingleThreadedExecutor) -> None:
        """Serves until those who wait for the result of a goal have it, for they would wait for ever."""
        if not self._action.busy:
            return
        end = time.monotonic() + _ANSWERS
        while self._action.busy and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        linger = time.monotonic() + _LINGER
        while time.monotonic() < linger:
            executor.spin_once(timeout_sec=0.05)

    def let_go(self) -> None:
        """Cuts a release short: the torque goes at once. Safe in a signal handler."""
        if self._hardware is not None:
            self._hardware.loop.let_go()

    def autostart(self) -> None:
        """Configures and activates, where the parameter asks for it.

        A robot that cannot be activated yet, as it is not homed, stays configured for its operator.

        Raises:
            DriverError: it cannot be configured.
        """
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise self._failure or DriverError("it cannot be configured")
        self.trigger_activate()

    def tell_what_it_waits_for(self) -> None:
        """A driver that nobody has configured says so."""
        if self._hardware is None:
            name = f"{self.get_namespace().rstrip('/')}/{self.get_name()}"
            self.get_logger().info(
                f"waiting for configure: ros2 lifecycle set {name} configure, then activate (autostart: both at once)"
            )

    def _failed(self, what: str, error: Exception) -> TransitionCallbackReturn:
        self._failure = error
        words = str(error) if isinstance(error, DriverError) else "".join(format_exception(error))
        self.get_logger().error(f"cannot {what}: {words}")
        return TransitionCallbackReturn.FAILURE

    def _activate(self) -> None:
        """Raises DriverError; an activation that takes too long is taken back when it ends."""
        hardware = self._opened()
        robot = hardware.robot
        hardware.loop.ask(robot.activate, _ACTIVATION, undo=lambda _: robot.release())

    def _release(self) -> None:
        """Raises StoppedError, ReleaseError, DriverError."""
        hardware = self._opened()
        self._do(
            lambda hardware, now: hardware.robot.begin_release(now, "the driver is deactivated")
        )
        end = hardware.clock() + hardware.release_time
        while not self._do(lambda hardware, _: hardware.robot.released) and hardware.clock() < end:
            if self._do(lambda hardware, _: hardware.robot.holding):
                raise StoppedError(
                    "a stop came on the way to rest: the robot holds, with its torque on; "
                    " deactivate it again to let go"
                )
            self._publish()
        problems = self._do(lambda hardware, _: hardware.robot.release(), _LETTING_GO)
        if problems:
            raise ReleaseError(release_report(problems).message)

    # --- services ------------------------------------------------------------------------------

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """In the thread of its own node; one stop answers all who have called by then, as it takes a cycle."""
        others = list(self._further_stops())
        try:
            hardware = self._opened()
            hardware.loop.insist(
                lambda now: hardware.robot.stop(now, "the service stop was called")
            )
        except Exception as error:  # noqa: BLE001 (the next call must find the service alive)
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, "stopped, and holding"
        for header in others:
            self._stop.send_response(response, header)
        return response

    def _further_stops(self) -> Iterator[object]:
        """The headers of calls that wait behind the one that is being served."""
        handle = self._stop.handle
        with handle:
            while (header := handle.service_take_request(Trigger.Request)[1]) is not None:
                yield header

    def _listen_for_emergencies(self) -> None:
        """Also to what was said before this driver began, which may be a stop but takes none back; from anybody."""
        listen = self._side.node.create_subscription
        listen(Bool, "emergency_stop", self._on_kept_emergency, _LATCHED)
        listen(Bool, "emergency_stop", self._on_emergency, _ANYBODY)

    def _adopt_emergency(self) -> None:
        """The emergency stop of the robot that the parameters name, as it was left."""
        problem = self._emergency.adopt(self.get_parameter("port").value)
        if problem:
            self.get_logger().error(problem)

    def _on_kept_emergency(self, word: Bool) -> None:
        if word.data:
            self._on_emergency(word)

    def _on_emergency(self, word: Bool) -> None:
        """In the thread of the service stop: nothing starts from here on, and what moves holds."""
        if word.data != self._emergency.on:
            problem = self._emergency.set(word.data)
            self.get_logger().error(
                f"EMERGENCY STOP {'on: nothing starts' if word.data else 'off'}. {problem}".strip()
            )
        hardware = self._hardware
        if word.data and hardware is not None:
            hardware.loop.submit(
                lambda now: hardware.robot.stop(now, "the emergency stop is on"),
                patience=math.inf,
            )

    def destroy_node(self) -> None:
        """Also ends the service stop."""
        self._side.close()
        super().destroy_node()

    def _on_home(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(
            response,
            lambda hardware, _: hardware.robot.home(),
            "the present cable length is the initial one",
        )

    def _on_reboot(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._answer(
            response,
            lambda hardware, _: hardware.robot.reboot(),
            "servos with a hardware error were restarted; home before the next activation",
        )

    def _answer(
        self,
        response: Trigger.Response,
        action: Callable[[Hardware, float], object],
        done: str,
    ) -> Trigger.Response:
        try:
            self._do(action, _SERVICE)
            response.success, response.message = True, done
        except DriverError as error:
            response.success, response.message = False, str(error)
        return response

    def _do(self, action: Callable[[Hardware, float], T], timeout: float = 2.0) -> T:
        """Has something done between two cycles, within a time (s). Raises DriverError."""
        hardware = self._opened()
        return hardware.loop.ask(lambda now: action(hardware, now), timeout)

    def _opened(self) -> Hardware:
        if self._hardware is None:
            raise DriverError("the driver is not configured")
        return self._hardware

    # --- telemetry -----------------------------------------------------------------------------

    def _publish(self) -> None:
        if not self.context.ok():
            return
        if self._hardware is not None:
            self._publish_all(self._hardware)
        elif self._shown is not None and self._shown[1] != self._emergency.on:
            self._show_inactive(str(self._shown[0]))

    def _read_clocks(self) -> ClockPair:
        """Both clocks now; a step of the ROS clock (NTP, a Pi without a clock of its own) is told.

        The robot goes by the monotonic clock: stamps jump with the ROS clock, motion and figures do not.
        """
        clock = self._robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns)  # a virtual robot's, which is both
        clocks = ClockPair.read(lambda: self.get_clock().now().nanoseconds)
        step = 0.0 if self._clocks is None else clocks.step_since(self._clocks)
        if step:
            self.get_logger().warning(f"the clock was set by {step:.3f} s: stamps jump by as much")
        self._clocks = clocks
        return clocks

    def _publish_all(self, hardware: Hardware) -> None:
        clocks = self._read_clocks()
        while hardware.samples:
            sample = hardware.samples.popleft()
            self._action.on_power(sample)
            self._power.publish(driver_messages.power(sample, clocks))
        while hardware.snapshots:
            self._publish_snapshot(hardware, hardware.snapshots.popleft(), clocks)

    def _publish_snapshot(self, hardware: Hardware, snapshot: Snapshot, clocks: ClockPair) -> None:
        self._latest = snapshot
        initial = hardware.settings.body.initial_length
        self._joint_states.publish(
            driver_messages.joint_state(hardware.joint_names, snapshot, clocks)
        )
        if not math.isnan(snapshot.commanded):
            self._commanded.publish(
                driver_messages.body_length(
                    BodyLength.COMMANDED, snapshot.command_time, snapshot.commanded, initial, clocks
                )
            )
        if not math.isnan(snapshot.cable):
            self._cable.publish(
                driver_messages.body_length(
                    BodyLength.CABLE, snapshot.read_time, snapshot.cable, initial, clocks
                )
            )
        self._show_gait_state(snapshot, clocks)
        self._action.on_snapshot(snapshot)

    def _show_gait_state(self, snapshot: Snapshot, clocks: ClockPair) -> None:
        player = snapshot.player
        run = player.active_run
        shown = (
            snapshot.active,
            snapshot.homed,
            self._emergency.on,
            player.phase,
            player.message,
            run and (run.number, run.onset, run.cycles, run.cycle(snapshot.command_time)),
        )
        if shown != self._shown:
            self._tell_fault(player)
            self._shown = shown
            self._gait_state.publish(
                driver_messages.gait_state(snapshot, clocks, emergency_stop=self._emergency.on)
            )

    def _tell_fault(self, player: PlayerState) -> None:
        """A fault is an error in the log, once, with its cause and what to do."""
        is_fault = player.phase is Phase.FAULT
        if is_fault and not self._faulty:
            self.get_logger().error(
                f"FAULT: {player.message}. The cable holds where it is. Mend the cause, then deactivate and "
                "activate; after a hardware error deactivate, reboot, home, activate"
            )
        self._faulty = is_fault

    def _show_inactive(self, reason: str) -> None:
        self._shown = (reason, self._emergency.on)
        message = GaitState(
            state=GaitState.INACTIVE, message=reason, emergency_stop=self._emergency.on
        )
        message.header.stamp = self._now()
        self._gait_state.publish(message)

    def _now(self) -> Time:
        """The stamp of what is told now."""
        clock = self._robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns).stamp(clock())
        stamp: Time = self.get_clock().now().to_msg()
        return stamp

    def _tracker_ready(self) -> bool:
        """Whether the robot is seen to stand, or so long was not that there is no tracker (discovery may take 3 s)."""
        if math.isinf(self._tracked):
            return time.monotonic() - self._born > _DISCOVERY
        return self._robot_time() - self._tracked < _FRESH and self._stillness.lasts

    def _sees_robot(self) -> bool:
        """Whether samples of the tracker come in."""
        return self._robot_time() - self._tracked < _FRESH

    def _robot_time(self) -> float:
        return time.monotonic() if self._robot_clock is None else self._robot_clock()

    def _on_tracker(self, message: Tracker) -> None:
        now = self._tracked = self._robot_time()
        self._stillness.observe(now, message.rear_position, message.front_position)
        clocks = self._read_clocks()
        self._action.on_position(clocks.monotonic(message.header.stamp), message.rear_position)

    def _publish_diagnostics(self) -> None:
        stamp = self._now()
        hardware, latest = self._hardware, self._latest
        if hardware is not None:
            hardware.loop.check()
        if hardware is None or latest is None:
            reports = [offline_report(self._failure)]
        else:
            reports = hardware.report(latest)
        reports.append(network_report(str(self._reach), is_local=self._reach.is_local))
        self._diagnostics.publish(
            driver_messages.diagnostics(reports, stamp, self.get_namespace().strip("/"))
        )


def main(args: list[str] | None = None) -> int:
    """Runs the driver until SIGINT, SIGTERM or SIGHUP; the servos are released on every way out.

    A first signal brings the robot to rest, a later Ctrl-C lets go at once.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    about = "Plays gaits on the robot and publishes what it measures, as a lifecycle node."
    try:
        return run_node("driver", about, driver_parameters.rows, _run, (ConfigurationError,), args)
    except DriverError as error:
        print(f"driver: {error}", file=sys.stderr)  # noqa: T201 (the command's own words)
        return 1


def _run(ended: Ending) -> None:
    node = DriverNode()
    ended.again = node.let_go
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        spare_pauses()
        node.autostart()
        node.tell_what_it_waits_for()
        while not ended():
            executor.spin_once(timeout_sec=0.05)
    finally:
        node.close("the driver ends")
        node.answer_goals(executor)
        node.destroy_node()


if __name__ == "__main__":
    sys.exit(main())
