# SPDX-License-Identifier: Apache-2.0
"""The optimizer node as a process: cold start, requests, actions, cancelling, restart, Ctrl-C."""

import copy
import math

import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from distributed import LocalCluster
from harness import NAMESPACE, TIMEOUT_S, Probe, Processes
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.msg import Gait, GaitPrediction
from worm_msgs.srv import RequestGait

SMALL = {
    "population": 20,
    "generations": 5,
    "scan_highest_m": 0.004,
    "scan_step_m": 0.001,
    "samples": 20,
    "kept_gaits": 12,
}


@pytest.fixture
def start(processes: Processes, tmp_path):
    def start(name: str = "optimizer", **parameters):
        settings = {**SMALL, "cache_directory": tmp_path / "cache", **parameters}
        arguments = ["--ros-args", "-r", f"__ns:={NAMESPACE}"]
        for key, value in settings.items():
            arguments += ["-p", f"{key}:={value}"]
        return processes.start_executable("worm_optimizer", "optimizer_node", *arguments, name=name)

    return start


class User:
    """Asks the node as its users do."""

    def __init__(self, probe: Probe) -> None:
        self._probe = probe

    def ask(self, objective: int = RequestGait.Request.CRUISE, direction: int = 1, **values):
        """The answer to a request."""
        request = RequestGait.Request(objective=objective, direction=direction, **values)
        return self._probe.call(RequestGait, "request_gait", request)

    def served(self, direction: int = 1):
        """The cruising gait, once there is a front."""
        answers = []

        def answered() -> bool:
            answers.append(self.ask(direction=direction))
            return answers[-1].success

        self._probe.wait_for(answered, "front", timeout_s=90.0)
        return answers[-1].prediction

    def send(self, name: str, goal, feedback=None):
        """The handle of a goal."""
        told = None if feedback is None else lambda message: feedback.append(message.feedback)
        kind = {"optimize_gaits": OptimizeGaits, "scan_margin": ScanMargin}[name]
        handle = self._probe.send_goal(kind, name, goal, told)
        assert handle.accepted
        return handle

    def outcome(self, handle):
        """How a goal ended."""
        return self._probe.result(handle.get_result_async(), "result", timeout_s=90.0)


@pytest.fixture
def user(probe: Probe) -> User:
    return User(probe)


def test_cold_start_requests_and_refusals(start, user):
    start()
    early = user.ask()
    assert early.success or "the front is being computed" in early.message
    assert early.success or math.isnan(early.prediction.speed)
    gait = user.served()
    assert gait.gait.margin == 0.003  # the cliff at the steps of this scan
    assert gait.speed > 0.0
    assert gait.groove_phase == pytest.approx(0.0011)
    assert gait.success_probability > 0.9
    assert user.served(Gait.REVERSE).speed == gait.speed

    far = user.ask(RequestGait.Request.MIN_POWER_AT_SPEED, speed=1.0)
    assert not far.success
    assert "no gait of the front reaches 1 m/s" in far.message
    fastest = user.ask(RequestGait.Request.MAX_SPEED).prediction
    assert far.prediction == fastest

    reachable = user.ask(RequestGait.Request.MIN_POWER_AT_SPEED, speed=0.9 * fastest.speed)
    assert reachable.success
    assert reachable.prediction.speed >= 0.9 * fastest.speed

    for wrong in (
        {"objective": 77},
        {"objective": RequestGait.Request.MIN_POWER_AT_SPEED, "speed": math.nan},
        {"objective": RequestGait.Request.MAX_SPEED_AT_POWER, "power": -1.0},
        {"direction": 0},
    ):
        answer = user.ask(**wrong)
        assert not answer.success
        assert answer.message


def test_the_long_work_of_a_promise_is_the_clusters(start, user):
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", memory_limit=0
    ) as cluster:
        start(robustness="any_phase", scheduler=cluster.scheduler_address)
        assert user.served().success_probability_any_phase > 0.8
    goal = OptimizeGaits.Goal(margin=math.nan, direction=1, robustness="any_phase", generations=6)
    done = user.outcome(user.send("optimize_gaits", goal))
    assert done.status == GoalStatus.STATUS_ABORTED
    assert f"the cluster at {cluster.scheduler_address}: no Dask scheduler" in done.result.message
    assert user.ask().success  # from the front that there is


def test_an_optimisation_reports_its_generations_and_is_served_after_a_restart(start, user):
    node = start(margin_m=0.002)
    assert user.served().gait.margin == 0.002
    feedback = []
    goal = OptimizeGaits.Goal(margin=0.001, direction=1, generations=4, seed=9)
    handle = user.send("optimize_gaits", goal, feedback)
    done = user.outcome(handle)
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert done.result.success
    assert done.result.margin == 0.001
    assert done.result.source in ("nsga2", "map")
    assert 0.0 < done.result.hypervolume_share < 1.01
    assert [gait.speed for gait in done.result.front] == sorted(
        gait.speed for gait in done.result.front
    )
    generations = [told.generation for told in feedback if told.generation]
    assert generations == sorted(generations)
    assert generations
    assert all(told.generations == 4 for told in feedback if told.generation)
    assert user.ask().prediction == done.result.cruise
    assert user.ask(direction=Gait.REVERSE).prediction == mirrored(done.result.cruise)

    node.interrupt()
    assert node.wait(TIMEOUT_S) == 0
    start("restarted", margin_m=0.002)
    user.served()
    assert user.ask().prediction == done.result.cruise
    assert user.ask(direction=Gait.REVERSE).prediction == mirrored(done.result.cruise)


def mirrored(prediction: GaitPrediction) -> GaitPrediction:
    """The same in the other direction, which it is for a robot with equal modules."""
    other = copy.deepcopy(prediction)
    other.gait.direction = -prediction.gait.direction
    return other


def test_a_front_that_cannot_be_kept_is_served_all_the_same(start, user, tmp_path):
    node = start(margin_m=0.002)
    user.served()
    for front in (tmp_path / "cache").glob("front-*.json"):
        front.with_name(front.name.replace("front", "current")).mkdir()  # no file can go there
    goal = OptimizeGaits.Goal(margin=0.001, direction=-1, generations=4)
    done = user.outcome(user.send("optimize_gaits", goal))
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert done.result.success
    assert user.ask(direction=Gait.REVERSE).prediction == done.result.cruise
    assert user.ask().prediction == mirrored(done.result.cruise)
    assert node.output().count("but is not kept") == 2


def test_a_cancelled_optimisation_ends_at_once_and_changes_nothing(start, user, probe):
    start(margin_m=0.002)
    before = user.served()
    feedback = []
    goal = OptimizeGaits.Goal(margin=0.001, direction=1, generations=100_000)
    handle = user.send("optimize_gaits", goal, feedback)
    probe.wait_for(lambda: feedback, "feedback")
    assert user.ask().prediction == before
    probe.result(handle.cancel_goal_async(), "answer to the cancel")
    done = user.outcome(handle)
    assert done.status == GoalStatus.STATUS_CANCELED
    assert not done.result.success
    assert user.ask().prediction == before


def test_a_goal_that_is_none_is_aborted_with_the_reason(start, user):
    start(margin_m=0.002).wait_for_line("optimizer ready", 90.0)
    goal = OptimizeGaits.Goal(margin=-1.0, direction=1)
    done = user.outcome(user.send("optimize_gaits", goal))
    assert done.status == GoalStatus.STATUS_ABORTED
    assert "margin: -1.0 m" in done.result.message


def test_the_scan_finds_the_cliff_and_reports_progress(start, user):
    start()
    feedback = []
    goal = ScanMargin.Goal(lowest=0.0032, highest=0.0036, step=1e-4, direction=1)
    handle = user.send("scan_margin", goal, feedback)
    done = user.outcome(handle)
    assert done.status == GoalStatus.STATUS_SUCCEEDED
    assert done.result.cliff_margin == pytest.approx(0.0034)
    assert done.result.lost_branch == 2
    assert done.result.closed_form_cliff_margin == pytest.approx(0.003419, abs=1e-6)
    assert list(done.result.optimal_branch) == [2, 2, 2, 1, 1]
    assert feedback[-1].fraction == pytest.approx(1.0)


def test_a_new_parameter_file_invalidates_the_front(start, user, probe, tmp_path):
    start(margin_m=0.002)
    before = user.served()
    file = tmp_path / "parameters.yaml"
    file.write_text("slack: 0.0085\n")
    assert not set_parameter_file(probe, tmp_path / "absent.yaml").successful
    assert user.ask().prediction == before
    assert set_parameter_file(probe, file).successful
    # Not a moment longer is the old front served.
    told = user.ask()
    assert told.prediction != before
    after = user.served()
    assert after.gait.stroke != before.gait.stroke


def set_parameter_file(probe: Probe, path):
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
    request = SetParameters.Request(parameters=[Parameter(name="parameter_file", value=value)])
    return probe.call(SetParameters, "optimizer/set_parameters", request).results[0]


def test_diagnostics_tell_what_is_served(start, probe):
    arrays = probe.collect(DiagnosticArray, "/diagnostics", 10)
    start(margin_m=0.002)

    def levels():
        return [status.level for array in arrays for status in array.status]

    probe.wait_for(lambda: DiagnosticStatus.OK in levels(), "healthy status", timeout_s=90.0)
    assert {status.name for status in arrays[-1].status} == {
        "worm/optimizer: forward front",
        "worm/optimizer: reverse front",
    }


def test_ctrl_c_while_it_computes_ends_it_with_its_worker(start, user, probe):
    node = start(generations=100_000)
    probe.wait_for(lambda: "done" in user.ask().message, "answer")
    node.interrupt()
    assert node.wait(TIMEOUT_S) == 0
    assert "Traceback" not in node.output()


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        ({"parameter_file": "/nowhere.yaml"}, "/nowhere.yaml: cannot be read"),
        ({"stroke_low_m": 0.09, "stroke_high_m": 0.01}, "bounds: stroke from 0.09 to 0.01 m"),
        ({"limits.servo_model": "XM430-W350"}, "without the driver's parameter file"),
    ],
)
def test_parameters_that_cannot_work_end_it_with_one_line(start, parameters, says):
    node = start(**parameters)
    assert node.wait(TIMEOUT_S) == 2
    assert says in node.output()
    assert "Traceback" not in node.output()
