# SPDX-License-Identifier: Apache-2.0
"""The optimizer node as a process: start, requests, actions, another parameter file, Ctrl-C."""

import pytest
from action_msgs.msg import GoalStatus
from harness import TIMEOUT_S, Probe, Processes
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.msg import Gait
from worm_msgs.srv import RequestGait
from worm_optimizer.operation.processes import Process

KINDS = {"optimize_gaits": OptimizeGaits, "scan_margin": ScanMargin}
SMALL = {"scan_highest_m": 0.004, "scan_step_m": 0.001, "samples": 20}


@pytest.fixture
def start(processes: Processes):
    def start(**parameters: object) -> Process:
        return processes.start_node("worm_optimizer", "optimizer_node", **SMALL, **parameters)

    return start


class User:
    """Client of all services and actions of the node."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe

    def request_gait(
        self, objective: int = RequestGait.Request.CRUISE, direction: int = 1, **values
    ):
        """Return the response to a request."""
        request = RequestGait.Request(objective=objective, direction=direction, **values)
        return self._probe.call(RequestGait, "request_gait", request)

    def served(self, direction: int = 1):
        """Return the cruising gait."""
        answer = self.request_gait(direction=direction)
        assert answer.success, answer.message
        return answer.prediction

    def send(self, name: str, goal):
        """Return the handle of a goal."""
        handle = self._probe.send_goal(KINDS[name], name, goal, None)
        assert handle.accepted
        return handle

    def outcome(self, handle):
        """Return the status with which a goal ended."""
        return self._probe.result(handle.get_result_async(), "result", timeout_s=90.0)


@pytest.fixture
def user(probe: Probe) -> User:
    return User(probe)


def test_cold_start_requests_and_refusals(start, user):
    start()
    gait = user.served()
    assert gait.gait.margin == 0.003  # the cliff at the steps of this scan
    assert gait.speed > 0.0
    assert gait.groove_phase == pytest.approx(0.0011)
    assert gait.success_probability > 0.9
    assert user.served(Gait.REVERSE).speed == pytest.approx(gait.speed, rel=1e-6)

    far = user.request_gait(RequestGait.Request.MIN_POWER_AT_SPEED, speed=1.0)
    assert not far.success
    assert far.status == RequestGait.Response.UNREACHABLE
    assert "1 m/s" in far.message
    fastest = user.request_gait(RequestGait.Request.MAX_SPEED).prediction
    assert far.prediction == fastest

    given = user.request_gait(RequestGait.Request.GIVEN, gait=fastest.gait)
    assert given.success
    assert given.prediction == fastest
    longer = user.request_gait(RequestGait.Request.GIVEN, gait=fastest.gait, initial_length=0.2962)
    assert longer.prediction.groove_phase == pytest.approx(0.0021)

    invalid = user.request_gait(77)
    assert not invalid.success
    assert invalid.message


def test_an_optimisation_is_served_in_both_directions(start, user):
    start(margin_m=0.002)
    assert user.served().gait.margin == 0.002
    goal = OptimizeGaits.Goal(margin=0.001, direction=1, seed=9)
    done = user.outcome(user.send("optimize_gaits", goal))
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert done.result.success
    assert done.result.margin == 0.001
    speeds = [gait.speed for gait in done.result.front]
    assert speeds == sorted(speeds)
    assert user.request_gait().prediction == done.result.cruise
    reverse = user.request_gait(direction=Gait.REVERSE).prediction
    assert (reverse.gait.direction, reverse.gait.margin) == (Gait.REVERSE, 0.001)
    assert reverse.power == pytest.approx(done.result.cruise.power, rel=1e-6)
    goal = ScanMargin.Goal(lowest=0.0032, highest=0.0036, step=1e-4, direction=1)
    scan = user.outcome(user.send("scan_margin", goal)).result
    assert scan.cliff_margin == pytest.approx(0.003419, abs=1e-6)
    assert scan.lost_branch == 2
    assert scan.closed_form_cliff_margin == pytest.approx(0.003419, abs=1e-6)
    assert list(scan.optimal_branch) == [2, 2, 2, 1, 1]


def test_what_cannot_be_computed_has_its_reason_and_changes_nothing(start, user):
    start(margin_m=0.002)
    before = user.served()
    for name, goal, reason in (
        ("optimize_gaits", OptimizeGaits.Goal(margin=-1.0, direction=1), "margin: -1.0 m"),
        ("scan_margin", ScanMargin.Goal(direction=7), "7"),
        ("optimize_gaits", OptimizeGaits.Goal(margin=0.09, direction=1), "lower the margin"),
    ):
        done = user.outcome(user.send(name, goal))
        assert done.status == GoalStatus.STATUS_ABORTED
        assert reason in done.result.message
    assert user.request_gait().prediction == before


def test_where_the_robot_rests_the_front_is_another(start, user):
    start(margin_m=0.002)
    own, resting = user.request_gait(), user.request_gait(initial_length=0.2902)
    assert resting.success
    assert resting.prediction.groove_phase == pytest.approx(0.2902 - 17 * 0.0173, abs=1e-9)
    assert resting.prediction.gait.stroke != own.prediction.gait.stroke
    assert "margin 2.00 mm, as at groove phase" in resting.message
    assert not user.request_gait(initial_length=2.0).success


def test_a_new_parameter_file_invalidates_the_front(start, user, probe, tmp_path):
    start(margin_m=0.002)
    before = user.served()
    file = tmp_path / "parameters.yaml"
    file.write_text("slack: 0.0085\n")
    assert not set_parameter_file(probe, tmp_path / "absent.yaml").successful
    assert user.request_gait().prediction == before
    assert set_parameter_file(probe, file).successful
    # From now on the old front is not served.
    reported = user.request_gait()
    assert reported.prediction != before
    after = user.served()
    assert after.gait.stroke != before.gait.stroke


def set_parameter_file(probe: Probe, path):
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
    request = SetParameters.Request(parameters=[Parameter(name="parameter_file", value=value)])
    return probe.call(SetParameters, "optimizer/set_parameters", request).results[0]


def test_ctrl_c_ends_a_long_computation(start, user):
    node = start(margin_m=0.002)
    node.wait_for_line("optimizer ready", 90.0)
    # without an interruption this scan takes many times the time after which its parent would kill the node
    user.send("scan_margin", ScanMargin.Goal(lowest=0.0, highest=0.02, step=3e-6, direction=1))
    node.interrupt()
    assert node.wait(TIMEOUT_S) == 0
    assert "Traceback" not in node.output()
