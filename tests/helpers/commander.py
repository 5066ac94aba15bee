# SPDX-License-Identifier: Apache-2.0
"""What tests of the driver node use: its parameters, an operator's requests, and the torque of the servos."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import LATCHED, TIMEOUT_S
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile
from std_srvs.srv import Trigger

from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_msgs.action import RunGait
from worm_msgs.msg import BodyLength, Gait, GaitState
from worm_msgs.srv import InjectFault

SERVOS = (1, 11, 12)  # of the virtual robot: one cable servo, two fin servos
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/GoalStatus
#: of a latched topic, whose queue also keeps a state that is shorter than a pause of this process
EVERY_STATE = QoSProfile(depth=1000, reliability=LATCHED.reliability, durability=LATCHED.durability)


def parameters(directory: Path, **changes: object) -> dict[str, object]:
    """Return the parameters of a driver on that robot, whose time waits if the test's machine is busy."""
    return {
        "port": directory / "servo_bus",
        "i2c_bus": directory / "i2c.sock",
        "cable_servos.spool_radius_m": "[0.025]",
        "home_at_start": "true",
        **changes,
    }


class Commander:
    """Client with all requests of an operator to the driver."""

    def __init__(self, probe) -> None:
        self.probe = probe
        self.states = probe.collect(GaitState, "gait_state", EVERY_STATE)
        self.reports: list[DiagnosticArray] = probe.collect(DiagnosticArray, "/diagnostics")

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.probe.call(ChangeState, "driver/change_state", request).success

    def activate(self) -> None:
        assert self.change(Transition.TRANSITION_CONFIGURE)
        assert self.change(Transition.TRANSITION_ACTIVATE)

    def lifecycle_state(self) -> int:
        return self.probe.call(GetState, "driver/get_state", GetState.Request()).current_state.id

    def send(
        self,
        stroke=0.03,
        frequency=0.4,
        cycles=1,
        direction=Gait.FORWARD,
        feedback=None,
        **waveform,
    ):
        gait = Gait(stroke=stroke, frequency=frequency, direction=direction, **waveform)
        goal = RunGait.Goal(gait=gait, cycles=cycles)
        return self.probe.send_goal(RunGait, "run_gait", goal, feedback)

    def result(self, goal, timeout_s: float = TIMEOUT_S):
        return self.probe.result(goal.get_result_async(), "result of the gait", timeout_s)

    def set_parameter(self, name: str, value: object):
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.probe.call(SetParameters, "driver/set_parameters", request).results[0]

    def trigger(self, name: str) -> Trigger.Response:
        return self.probe.call(Trigger, name, Trigger.Request())

    def inject(self, **fields: object) -> None:
        request = InjectFault.Request(**fields)
        assert self.probe.call(InjectFault, "inject_fault", request).success

    def wait_for_state(self, state: int, what: str, text: str = "") -> GaitState:
        """Wait until the driver is in a state whose message contains a text."""

        def there() -> GaitState | None:
            last = self.states[-1] if self.states else None
            return last if last and last.state == state and text in last.message else None

        return self.probe.wait_for(there, what)

    def wait_for_report(self, name: str, level: bytes, expected: str) -> DiagnosticStatus:
        def found():
            statuses = [s for report in self.reports for s in report.status]
            return [
                s for s in statuses if s.name == name and s.level == level and expected in s.message
            ]

        return self.probe.wait_for(found, f"report of {name} with {expected!r}")[0]


@contextmanager
def servo_bus(directory: Path) -> Iterator[ServoBus]:
    """Open the servo bus for the test itself while no driver has it; a robot on a busy machine answers late."""
    port = str(directory / "servo_bus")
    with closing(ServoBus.open(port, 1_000_000, latency=0.1, retries=99)) as bus:
        yield bus


def torques(directory: Path) -> list[int]:
    """Return the torque of each servo."""
    with servo_bus(directory) as bus:
        return [bus.read(servo, COMMON["torque_enable"]) for servo in SERVOS]


def stamp(message) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def run_into_a_gait(commander, probe) -> list[BodyLength]:
    lengths = probe.collect(BodyLength, "body_length/cable")
    commander.activate()
    # slow, so that the robot is still contracted when a busy machine takes seconds for what follows
    commander.goal = commander.send(stroke=0.06, frequency=0.15, cycles=20)
    probe.wait_for(lambda: lengths and lengths[-1].length_change < -0.02, "contraction")
    return lengths


EVERY_ANSWER = QoSProfile(history=HistoryPolicy.KEEP_ALL)  # by default a client keeps the last ten


def goal_client(probe) -> ActionClient:
    client = ActionClient(
        probe.node,
        RunGait,
        "run_gait",
        goal_service_qos_profile=EVERY_ANSWER,
        result_service_qos_profile=EVERY_ANSWER,
    )
    probe.meet("run_gait/_action/send_goal")
    probe.wait_for(client.server_is_ready, "action run_gait")
    return client
