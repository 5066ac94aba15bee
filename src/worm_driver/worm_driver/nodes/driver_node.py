# SPDX-License-Identifier: Apache-2.0
"""The lifecycle node ``driver``: ROS on one side, the robot's loop on the other, nothing of its own in between.

configure opens and checks everything, activate enables the torque; deactivate, cleanup, shutdown, SIGINT, SIGTERM and
an escaped exception bring the gait to rest and release the servos.
"""

import os
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from traceback import format_exception
from typing import TypeVar

from diagnostic_msgs.msg import DiagnosticArray
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
from worm_driver.errors import ConfigurationError, DriverError, ReleaseError, StoppedError
from worm_driver.nodes import driver_messages, driver_parameters
from worm_driver.nodes.lifecycle_requests import LifecycleRequests
from worm_driver.nodes.run_gait_action import RunGaitAction
from worm_driver.nodes.sole_driver import SoleDriver
from worm_driver.nodes.stamps import Stamps
from worm_driver.nodes.stop_services import StopServices
from worm_driver.nodes.telemetry_publisher import TelemetryPublisher
from worm_driver.nodes.tracker_listener import TrackerListener
from worm_msgs import network, readiness
from worm_msgs.node_command import declare, run_node
from worm_msgs.ros_process import ShutdownRequest, spare_pauses

T = TypeVar("T")

#: s, how long the interpreter lets a thread run before another may; the default of 5 ms would be half a cycle
_SWITCH_INTERVAL = 0.0005

#: s, in which the servos must have been enabled, homed, or released
_ACTIVATION = 5.0
_SERVICE_TIME = 10.0
_LETTING_GO = 5.0

#: s between two looks at what the threads of the hardware have left: fewer wake-ups than cycles, as each costs the
#: servo thread the interpreter for a while
_PUBLISH_PERIOD = 0.04

#: s, in which a goal's result must have been made, and for which it has to leave: DDS acknowledges no answer
_ANSWERS = 1.0
_LINGER = 0.3

#: why everything is closed when the process ends
_END = "the driver ends"

_Action = Callable[[Hardware, float], object]
_SERVICES: tuple[tuple[str, _Action, str], ...] = (
    (
        "home",
        lambda hardware, _: hardware.robot.home(),
        "the present cable length is the initial one",
    ),
    (
        "reboot",
        lambda hardware, _: hardware.robot.reboot(),
        "servos with a hardware error were restarted; home before the next activation",
    ),
)


class DriverNode(LifecycleNode):
    """See the module.

    Attributes:
        unreleased: what failed when the robot was closed last, in words: a servo may still have its torque.
    """

    def __init__(self) -> None:
        super().__init__("driver")
        declare(self, driver_parameters.rows)
        driver_parameters.check_time(self)
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
            self, self._stamps, lambda: self._hardware, lambda: self._tracker.sees_robot()
        )
        self._tracker = TrackerListener(self, self._stamps, self._action.on_position)
        self._telemetry = TelemetryPublisher(self, self._stamps, self._action, self._emergency)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._stops = StopServices(
            self,
            self._opened,
            self._emergency,
            self._action.stop,
            self._action.on_heartbeat,
            self._stamps.now,
        )
        for name, action, done in _SERVICES:
            self.create_service(Trigger, name, partial(self._serve, action, done))
        self._lifecycle = LifecycleRequests(self)
        steady = RosClock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_PUBLISH_PERIOD, self._publish, clock=steady)
        self.create_timer(1.0, self._publish_diagnostics, clock=steady)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self._publish()

    # --- parameters ----------------------------------------------------------------------------

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        """Reject what cannot take effect, and what would raise a limit, while the robot is open."""
        reason = driver_parameters.why_not_set(
            self, parameters, configured=self._hardware is not None
        )
        return SetParametersResult(successful=not reason, reason=reason)

    def _apply_parameters(self, _: Sequence[Parameter]) -> None:
        """What takes effect at once does."""
        if self._hardware is None:
            return
        said = self._hardware.apply_settings(driver_parameters.settings(self))
        if said:
            self.get_logger().warning(said)
        self.get_logger().info(self._hardware.rest_line())

    # --- lifecycle -----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Opens and checks everything; FAILURE, with the reason in the log and the diagnostics, if it cannot."""
        try:
            settings = driver_parameters.settings(self)
            self._adopt_emergency()
            self._sole.require()
            self._hardware = Hardware(settings, self._tracker.is_ready, self._why_not_start)
            self._stamps.robot_clock = self._hardware.clock
        except Exception as error:  # noqa: BLE001 (rclpy would drop it without a word)
            return self._failed("configure", error)
        self._failure, self.unreleased = None, []
        for line in self._hardware.description():
            self.get_logger().info(line)
        if restriction := self._emergency.restriction(os.environ):
            self.get_logger().warning(restriction)
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
        """Brings the gait to rest, releases the servos and closes everything; FAILURE if one may have its torque.

        A stop on the way leaves the robot holding, with its torque on.
        """
        if self.close("the driver shuts down"):
            return TransitionCallbackReturn.FAILURE
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Releases and closes everything, so that the driver can be configured again."""
        self.close(f"a transition failed: {self._failure}")
        self.get_logger().error(
            "the driver is unconfigured now, with everything closed: configure and activate it once the servos answer"
        )
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
        self._hardware, self.unreleased = None, problems
        self._why_closed = "; ".join((reason, *problems))
        self._tracker.forget()
        if problems and self._failure is None:
            self._failure = ReleaseError("; ".join(problems))
        for problem in problems:
            self.get_logger().error(f"on release: {problem}")
        if self.context.ok():
            self._telemetry.publish(hardware)
            self._action.abandon(reason)
            self._publish()
            self._telemetry.deliver()
        return problems

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

    def reject_transitions(self) -> None:
        """Carry no transition out from now on: the process ends."""
        self._lifecycle.refuse()

    def begin_shutdown(self) -> None:
        """Begin to bring the robot to rest, before any stop that comes from now on. Safe in a signal handler."""
        if self._hardware is not None:
            self._hardware.loop.shutdown(_END)

    def release_at_once(self) -> None:
        """Cuts a release short: the torque goes at once. Safe in a signal handler."""
        if self._hardware is not None:
            self._hardware.loop.release_at_once()

    def autostart(self) -> None:
        """Configures and activates, where the parameter asks for it.

        A robot that cannot be activated yet, as it is not homed, stays configured for its operator. Raises DriverError:
        it cannot be configured, and the parameter does not leave that to its operator, either.
        """
        if not self.get_parameter("autostart").value:
            return
        if self.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            self.trigger_activate()
        elif not self.get_parameter("stay_on_failure").value:
            raise self._failure or DriverError("it cannot be configured")

    def wait_until_sole(self, ended: ShutdownRequest) -> None:
        """Wait until this is the only driver of its namespace. Raises `ConfigurationError` where it is not."""
        self._sole.wait(ended)

    def log_awaited_transition(self) -> None:
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

    def _why_not_start(self) -> str:
        """In any thread: why neither torque nor a run may begin; empty when they may."""
        return self._emergency.why_not_start() or self._sole.problem

    def _activate(self) -> None:
        """Raises DriverError; an activation that takes too long is taken back when it ends."""
        self._sole.require()
        hardware = self._opened()
        robot = hardware.robot
        hardware.loop.run(robot.activate, _ACTIVATION, undo=lambda _: robot.shutdown())

    def _release(self) -> None:
        """Raises StoppedError, ReleaseError, DriverError."""
        hardware = self._opened()
        self._do(
            lambda hardware, now: hardware.robot.ramp_to_rest(now, "the driver is deactivated")
        )
        end = hardware.clock() + hardware.release_time
        while not self._do(lambda hardware, _: hardware.robot.released) and hardware.clock() < end:
            if self._do(lambda hardware, _: hardware.robot.holding):
                raise StoppedError(
                    "a stop or a FAULT came on the way to rest: the robot holds, with its torque on; "
                    "deactivate it again to let go"
                )
            self._publish()
        if not self._do(lambda hardware, _: hardware.robot.released):
            raise StoppedError(
                "the robot did not come to rest in time: it keeps its torque; deactivate it again to release it"
            )
        problems = self._do(lambda hardware, _: hardware.robot.release(), _LETTING_GO)
        if problems:
            raise ReleaseError(release_report(problems).message)

    # --- services ------------------------------------------------------------------------------

    def _adopt_emergency(self) -> None:
        """Continue with the emergency stop of the robot that the parameters name, as it was left."""
        problem = self._emergency.adopt(driver_parameters.latch_files(self))
        if problem:
            self.get_logger().error(problem)

    def destroy_node(self) -> None:
        """Also end the services that have threads of their own and the claim of the namespace."""
        self._lifecycle.close()
        self._stops.close()
        self._sole.close()
        super().destroy_node()

    def _serve(
        self, action: _Action, done: str, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        try:
            self._do(action, _SERVICE_TIME)
            response.success, response.message = True, done
        except DriverError as error:
            response.success, response.message = False, str(error)
        return response

    def _do(self, action: Callable[[Hardware, float], T], timeout: float = 2.0) -> T:
        """Has something done between two cycles, within a time (s). Raises DriverError."""
        hardware = self._opened()
        return hardware.loop.run(lambda now: action(hardware, now), timeout)

    def _opened(self) -> Hardware:
        if self._hardware is None:
            raise DriverError("the driver is not configured")
        return self._hardware

    # --- telemetry -----------------------------------------------------------------------------

    def _publish(self) -> None:
        if not self.context.ok():
            return
        if self._hardware is not None:
            self._telemetry.publish(self._hardware)
        else:
            self._telemetry.show_inactive(self._why_closed)

    def _publish_diagnostics(self) -> None:
        hardware, latest = self._hardware, self._telemetry.latest
        if hardware is not None:
            hardware.loop.check()
        self._sole.look()
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


def main(args: list[str] | None = None) -> int:
    """Runs the driver until SIGINT, SIGTERM or SIGHUP; the servos are released on every way out.

    A first signal brings the robot to rest, a later Ctrl-C releases it at once. A robot that was stopped on the way
    keeps its torque, as it would spring back: then the exit status is 1.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    about = "Plays gaits on the robot and publishes what it measures, as a lifecycle node."
    try:
        return run_node("driver", about, driver_parameters.rows, _run, (ConfigurationError,), args)
    except DriverError as error:
        print(f"driver: {error}", file=sys.stderr)  # noqa: T201 (the command's own words)
        return 1


def _run(ended: ShutdownRequest) -> int:
    node = DriverNode()
    ended.first, ended.again = node.begin_shutdown, node.release_at_once
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        spare_pauses()
        node.wait_until_sole(ended)
        readiness.announce()
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
