# SPDX-License-Identifier: Apache-2.0
"""Lifecycle node ``driver``, which connects ROS to the robot's control loop.

configure opens and checks the devices, activate enables the torque. deactivate, cleanup, shutdown, SIGINT, SIGTERM,
SIGHUP and an uncaught exception bring the robot to rest and release the servos.
"""

import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from traceback import format_exception

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.utilities import get_rmw_implementation_identifier
from std_srvs.srv import Trigger

from worm_driver.control.diagnostics import network_report, offline_report, release_report
from worm_driver.control.emergency import EmergencyLatch, state_folder
from worm_driver.control.hardware import Hardware
from worm_driver.control.robot import Robot
from worm_driver.driver_errors import ConfigurationError, DriverError, ReleaseError, StoppedError
from worm_driver.nodes import driver_messages, driver_parameters
from worm_driver.nodes.driver_messages import Stamps
from worm_driver.nodes.run_gait_action import RunGaitAction
from worm_driver.nodes.sole_driver import SoleDriver
from worm_driver.nodes.stop_services import StopServices
from worm_driver.nodes.telemetry_publisher import TelemetryPublisher
from worm_driver.nodes.tracker_listener import TrackerListener
from worm_msgs import network
from worm_msgs.node_command import declare
from worm_msgs.ros_process import ShutdownRequest, freeze_garbage_collection

#: s, time slice of the interpreter's threads; Python's default of 5 ms would be half a control cycle
_SWITCH_INTERVAL = 0.0005

#: s, timeout of enabling the servos
_ACTIVATION = 5.0
#: s, timeout of a service
_SERVICE_TIME = 10.0
#: s, timeout of releasing the servos
_RELEASE = 5.0

#: s, period of publishing the data of the hardware's threads. It is longer than a control cycle, because each wake-up
#: delays the servo thread.
_PUBLISH_PERIOD = 0.04

#: s, longest wait at the end of the process until all goals have results
_ANSWERS = 1.0
#: s, further time in which the results are sent, because DDS does not acknowledge responses
_LINGER = 0.3

#: reason that is reported when the end of the process closes the robot
_END = "the driver ends"
REJECTIONS = (ConfigurationError,)

_HOMED = "the present cable length is now the initial length"
_REBOOTED = "servos with a hardware error were restarted; if a cable servo was one of them, call home before activate"


class DriverNode(LifecycleNode):
    """Node of the driver, see the module. It waits for its devices before it offers anything.

    Args:
        ended: returns True once a signal requests the end.

    Attributes:
        unreleased: failures of the last closing. After a failure a servo may still have its torque.
    """

    def __init__(self, ended: Callable[[], bool]) -> None:
        super().__init__("driver")
        declare(self, driver_parameters.rows)
        driver_parameters.check_time(self)
        driver_parameters.wait_for_devices(self, ended)
        self._reach = network.reach(os.environ, get_rmw_implementation_identifier())
        self._sole = SoleDriver(self, on_network=not self._reach.is_local)
        self._hardware: Hardware | None = None
        self._failure: Exception | None = None
        self.unreleased: list[str] = []
        self._why_closed = "not configured"
        self._stamps = Stamps(self)
        self._emergency = EmergencyLatch(state_folder(os.environ))
        self._adopt_emergency()
        self._action = RunGaitAction(
            self, self._stamps, lambda: self._hardware, lambda: self._tracker.is_publishing()
        )
        self._tracker = TrackerListener(self, self._stamps, self._action.on_position)
        self._telemetry = TelemetryPublisher(self, self._stamps, self._emergency)
        self._sinks = (self._telemetry, self._action)  # of snapshots and power samples
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._stops = StopServices(
            self,
            self._opened,
            self._emergency,
            self._action.stop,
            self._action.on_heartbeat,
        )
        self.create_service(Trigger, "home", partial(self._serve, Robot.home, _HOMED))
        self.create_service(Trigger, "reboot", partial(self._serve, Robot.reboot, _REBOOTED))
        self._ends = False
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_PUBLISH_PERIOD, self._publish, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_limits)
        self._publish()

    # --- parameters ----------------------------------------------------------------------------

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Reject parameters that cannot take effect now, and higher limits while the robot is open."""
        reason = driver_parameters.why_not_set(
            self, parameters, configured=self._hardware is not None
        )
        return SetParametersResult(successful=not reason, reason=reason)

    def _apply_limits(self, _: Sequence[Parameter]) -> None:
        hardware = self._hardware
        if hardware is None:
            return
        try:
            settings = driver_parameters.with_limits(hardware.settings, self)
            warning = hardware.loop.run(lambda now: hardware.robot.apply_settings(now, settings))
        except DriverError as error:
            self.get_logger().error(f"the new limits have no effect: {error}")
            return
        if warning:
            self.get_logger().warning(warning)

    # --- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open and check the devices. Return FAILURE, with the reason in the log and the diagnostics, on an error."""
        try:
            settings = driver_parameters.settings(self)
            self._adopt_emergency()
            self._sole.require()
            self._hardware = Hardware(settings, self._tracker.is_ready, self._why_not_start)
            self._stamps.robot_clock = self._hardware.clock
            self._telemetry.open(self._hardware)
        except Exception as error:  # noqa: BLE001 (rclpy would drop it silently)
            return self._failed("configure", error)
        self._failure, self.unreleased = None, []
        for line in self._hardware.description():
            self.get_logger().info(line)
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable the torque."""
        try:
            self._activate()
        except Exception as error:  # noqa: BLE001 (as above)
            return self._failed("activate", error)
        self._failure = None
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the robot to rest and release the servos.

        Returns:
            FAILURE after a stop on the way to rest (the robot then holds), or if the robot is not at rest in time.
            ERROR, which closes everything, after any other problem. For example, a servo does not confirm that its
            torque is off, or the servo bus thread does not respond.
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
        """Close everything."""
        self.close("the driver is cleaned up")
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the robot to rest, release the servos and close everything.

        If a stop interrupts the return to rest, the torque stays on if the robot would otherwise spring back.

        Returns:
            FAILURE if a servo may still have its torque.
        """
        if self.close("the driver shuts down"):
            return TransitionCallbackReturn.FAILURE
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release and close everything, so that the driver can be configured again."""
        self.close(f"a transition failed: {self._failure}")
        self.get_logger().error(
            "the driver has closed all devices and is unconfigured: configure and activate it once the servos answer"
        )
        super().on_error(state)
        return TransitionCallbackReturn.SUCCESS

    def close(self, reason: str) -> list[str]:
        """Bring the robot to rest, release and close it. Needs no ROS; does nothing if no robot is open.

        Returns:
            Failures, one sentence each. After a failure a servo may still have its torque.
        """
        hardware = self._hardware
        if hardware is None:
            return []
        problems = hardware.close(reason, self._publish)
        self._log_spring_back(hardware)
        self._hardware, self.unreleased = None, problems
        self._why_closed = "; ".join((reason, *problems))
        self._tracker.forget()
        if problems and self._failure is None:
            self._failure = ReleaseError("; ".join(problems))
        for problem in problems:
            self.get_logger().error(f"on release: {problem}")
        if self.context.ok():
            self._pass_on(hardware)
            self._action.abandon(reason)
            self._publish()
            self._telemetry.deliver()
        return problems

    def answer_goals(self, executor: SingleThreadedExecutor) -> None:
        """Serve for a short time, so that every client receives the result of its goal and does not wait for ever."""
        if not self._action.busy:
            return
        end = time.monotonic() + _ANSWERS
        while self._action.busy and time.monotonic() < end:
            executor.spin_once(timeout_sec=0.05)
        linger = time.monotonic() + _LINGER
        while time.monotonic() < linger:
            executor.spin_once(timeout_sec=0.05)

    def reject_transitions(self) -> None:
        """Reject all further transitions, because the process ends."""
        self._ends = True

    def begin_shutdown(self) -> None:
        """Begin to bring the robot to rest and to end the control loop. Safe in a signal handler."""
        if self._hardware is not None:
            self._hardware.loop.shutdown(_END)

    def release_at_once(self) -> None:
        """Switch the torque off at once, without a return to rest. Safe in a signal handler."""
        if self._hardware is not None:
            self._hardware.loop.release_at_once()

    def autostart(self) -> None:
        """Configure and activate the driver if the parameter autostart is true.

        If the activation fails, as for a robot that is not homed, the driver stays configured.
        """
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()
        elif not self.get_parameter("stay_on_failure").value:
            raise self._failure or DriverError("the driver cannot be configured")

    def wait_until_sole(self, ended: ShutdownRequest) -> None:
        """Wait until this is the only driver of its namespace. Raises `ConfigurationError` if it is not."""
        self._sole.wait(ended)

    def log_awaited_transition(self) -> None:
        """Log how to configure the driver if it is not configured."""
        if self._hardware is None:
            name = f"{self.get_namespace().rstrip('/')}/{self.get_name()}"
            self.get_logger().info(
                f"waiting for configure: ros2 lifecycle set {name} configure, then activate (autostart: both at once)"
            )

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Execute a transition. Reject an impossible one, for which rclpy (7.1) would raise and end the node."""
        requested = request.transition
        possible = {
            number: label for number, label, *_ in self._state_machine.available_transitions
        }
        if not self._ends and (requested.label or requested.id in possible):
            return self._change_state(request, response)
        names = ", ".join(sorted(possible.values()))
        none = f"there is no transition {requested.id} from the present state, only: {names}"
        self.get_logger().error(f"rejected: {_END if self._ends else none}")
        response.success = False
        return response

    def _failed(self, transition: str, error: Exception) -> TransitionCallbackReturn:
        self._failure = error
        text = str(error) if isinstance(error, DriverError) else "".join(format_exception(error))
        self.get_logger().error(f"cannot {transition}: {text}")
        return TransitionCallbackReturn.FAILURE

    def _why_not_start(self) -> str:
        """Return why the torque must stay off and no run may begin; empty if both may start. Safe in any thread."""
        return self._emergency.why_not_start() or self._sole.problem

    def _activate(self) -> None:
        """Activate the robot. An activation that takes too long is reverted when it ends. Raises DriverError."""
        self._sole.require()
        hardware = self._opened()
        robot = hardware.robot
        try:
            hardware.loop.run(robot.activate, _ACTIVATION, undo=lambda _: robot.shutdown())
        except DriverError:
            self._log_spring_back(hardware)
            raise

    def _release(self) -> None:
        """Bring the robot to rest and release the servos. Raises StoppedError, ReleaseError, DriverError."""
        hardware = self._opened()
        robot, do = hardware.robot, hardware.loop.run
        do(lambda now: robot.ramp_to_rest(now, "the driver is deactivated"))
        end = hardware.clock() + hardware.release_time
        while not do(lambda _: robot.released):
            interrupted = do(lambda _: robot.holding)
            if interrupted or hardware.clock() >= end:
                cause = (
                    "a stop or a FAULT interrupted the return to rest"
                    if interrupted
                    else "the robot did not come to rest in time"
                )
                contracted = robot.actuators.contraction_text
                raise StoppedError(
                    f"{cause}: {contracted} and keeps its torque; deactivate it again"
                )
            self._publish()
        problems = do(lambda _: robot.release(), _RELEASE)
        self._log_spring_back(hardware)
        if problems:
            raise ReleaseError(release_report(problems).message)

    def _log_spring_back(self, hardware: Hardware) -> None:
        """Log the contraction if the last release made the robot spring back."""
        if hardware.robot.actuators.sprung_back:
            self.get_logger().error(hardware.robot.actuators.sprung_back)

    # --- services ------------------------------------------------------------------------------

    def _adopt_emergency(self) -> None:
        """Load the stored emergency stop of the robot that the parameters describe."""
        problem = self._emergency.adopt(driver_parameters.latch_files(self))
        if problem:
            self.get_logger().error(problem)

    def destroy_node(self) -> None:
        """Destroy the node. Also end the services with their own threads, and release the claim of the namespace."""
        self._stops.close()
        self._sole.close()
        super().destroy_node()

    def _serve(
        self,
        action: Callable[[Robot], object],
        done: str,
        _: Trigger.Request,
        response: Trigger.Response,
    ) -> Trigger.Response:
        try:
            hardware = self._opened()
            hardware.loop.run(lambda _: action(hardware.robot), _SERVICE_TIME)
            response.success, response.message = True, done
        except DriverError as error:
            response.success, response.message = False, str(error)
        return response

    def _opened(self) -> Hardware:
        if self._hardware is None:
            raise DriverError("the driver is not configured")
        return self._hardware

    # --- telemetry -----------------------------------------------------------------------------

    def _publish(self) -> None:
        if not self.context.ok():
            return
        if self._hardware is not None:
            self._pass_on(self._hardware)
        else:
            self._telemetry.show_inactive(self._why_closed)

    def _pass_on(self, hardware: Hardware) -> None:
        """Pass the snapshots and power samples since the last call to all sinks."""
        while hardware.samples:
            sample = hardware.samples.popleft()
            for sink in self._sinks:
                sink.on_power(sample)
        while hardware.snapshots:
            snapshot = hardware.snapshots.popleft()
            for sink in self._sinks:
                sink.on_snapshot(snapshot)

    def _publish_diagnostics(self) -> None:
        hardware, latest = self._hardware, self._telemetry.latest
        if hardware is not None:
            hardware.loop.check()
        self._sole.check()
        if hardware is None or latest is None:
            reports = [offline_report(self._failure)]
        else:
            reports = hardware.report(latest)
        reports.append(network_report(str(self._reach), is_local=self._reach.is_local))
        self._diagnostics.publish(
            driver_messages.diagnostics(
                reports, self._stamps.now(), self.get_namespace().strip("/")
            )
        )


def run(ended: ShutdownRequest) -> int:
    """Run the driver until SIGINT, SIGTERM or SIGHUP.

    The first signal brings the robot to rest and releases it; a later Ctrl-C releases it at once. If a stop
    interrupts the return to rest and the robot is still so contracted that it would spring back, the driver leaves the
    torque on. The exit status is then 1.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    try:
        return _serve(ended)
    except ConfigurationError:
        raise
    except DriverError as error:
        print(f"driver: {error}", file=sys.stderr)  # noqa: T201 (output of a command)
        return 1


def _serve(ended: ShutdownRequest) -> int:
    node = DriverNode(ended)
    ended.first, ended.again = node.begin_shutdown, node.release_at_once
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        freeze_garbage_collection()
        node.wait_until_sole(ended)
        if not ended():
            node.autostart()
            node.log_awaited_transition()
        while not ended():
            executor.spin_once(timeout_sec=0.05)
    finally:
        node.reject_transitions()
        node.close(_END)
        node.answer_goals(executor)
        node.destroy_node()
    return 1 if node.unreleased else 0
