# SPDX-License-Identifier: Apache-2.0
"""Random sequences of events for a driver on the virtual robot and the virtual clock, with invariants.

Thousands of steps with one or two spools and fast or slow cables: goals, cancels, stops, emergency stops, transitions,
services, signals, faults on the bus and of servos, wrong samples and ids, slowed servos, kills and restarts.
"""

import math
from dataclasses import replace

import pytest
from driver_rig import (
    SPOOLS,
    QuickSettings,
    Rig,
    robot_with_spools,
    settings,
    shaft_lengths,
    slow_down,
    spool_parameters,
)
from hypothesis import HealthCheck, Phase, seed
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from worm_driver.driver_errors import DriverError, StoppedError
from worm_driver.gait import gait_player
from worm_driver.gait.gait_player import Phase as GaitPhase
from worm_driver.servos.state_reader import SILENT
from worm_driver.virtual_robot.wire.faults import make_fault
from worm_msgs.gait import Gait, Profile

LIVES, STEPS = 20, 50

#: so that a sequence of 50 steps includes whole gaits
QUICK = settings(QuickSettings)
#: overshoot of the servo's own control of its speed
OVERSHOOT = 1.15
#: m, largest creep of a standing cable under its load, and s, in which the cable must have stopped
CREEP, BRAKING = 0.001, 0.20
#: m, largest distance of a goal from the range of a gait (an activation admits this much slack)
SLACK = 0.0105
#: m, from the shaft to a goal: the tolerated following error, and the motion of the cable in two cycles
REACH = QUICK.max_following_error + 2 * QUICK.period * QUICK.max_cable_speed
#: consecutive cycles with too large a following error, after which there must be a FAULT
LAGGED = 10
#: m, a robot with a larger contraction springs back when it is released
SPRINGS_BACK = 2.5e-3
#: m, largest error of a wrong sample that remains unnoticed: see docs/safety.md
OFF = 0.006
EMERGENCY = "the emergency stop is on"
MAY_MOVE = (GaitPhase.RUNNING, GaitPhase.STOPPING, GaitPhase.RETURNING, GaitPhase.TENSIONING)


def faults(names: list[str], **arguments: st.SearchStrategy) -> st.SearchStrategy:
    return st.tuples(st.sampled_from(names), st.fixed_dictionaries(arguments))


ONE = st.sampled_from([1, 11, 12])
FAULTS = st.one_of(
    faults(
        ["no_answer", "corrupted_crc", "truncated", "duplicated", "fuzzed", "error"],
        count=st.integers(1, 12),
    ),
    faults(["late"], count=st.integers(1, 30), value=st.floats(0.001, 0.040)),
    faults(
        ["no_answer", "vanished", "stalled", "input_voltage", "overload"],
        target=st.sampled_from([1, 2, 11, 12]),
        duration=st.floats(0.02, 0.4),
    ),
    faults(["wrong_position"], target=ONE, count=st.integers(1, 3), value=st.integers(-9000, 9000)),
    faults(
        ["wrong_id"], target=ONE, count=st.integers(1, 6), value=st.sampled_from([1, 11, 12, 77])
    ),
    faults(["i2c_nack", "ina219_overflow", "ina219_reset"], count=st.just(3)),
)
PAPERS = st.builds(Gait, st.floats(0.01, 0.06), st.floats(0.2, 0.4), st.sampled_from([1, -1]))
SHAPED = st.builds(
    Gait,
    st.floats(0.01, 0.06),
    st.floats(0.2, 0.4),
    st.sampled_from([1, -1]),
    pretension=st.sampled_from([0.0, 5e-5, 0.004, 0.015, 0.03]),
    contraction_share=st.sampled_from([0.3, 0.5, 0.65]),
    profile=st.sampled_from([Profile.COSINE, Profile.TRAPEZOID]),
    ramp_share=st.sampled_from([0.1, 0.3, 0.5]),
)
GAITS = st.one_of(PAPERS, SHAPED)


class Life(RuleBasedStateMachine):
    """A driver, its robot, and a record of the requests."""

    @initialize(spools=st.sampled_from([1, 2]), speed=st.sampled_from([0.01, 0.03, 0.12, 0.12]))
    def open(self, spools: int, speed: float) -> None:
        self.latched = False  # the emergency stop is on
        self.given = replace(QUICK, **spool_parameters(SPOOLS[:spools]), max_cable_speed=speed)
        robot = robot_with_spools(self.given.spools)
        self.rig: Rig = Rig(self.given, robot, why_not_start=self.why_not_start)
        self.virtual, self.clock = self.rig.virtual, self.rig.clock
        self.cables = self.virtual.servos[:spools]
        # s, in which every return to rest ends; an operator with a shorter timeout does not wait for it
        self.rest_timeout = math.pi * 0.11 / min(speed, 0.05) + 1.0
        self.alive = True
        self.goals: list[int] = []
        self.troubled_until = 0.0
        self.moved_until = 0.0
        self.stood_at: list[float] | None = None
        self.held = self.booted = ()  # torques and times of the last restart of the cable servos
        self.unmeasured = False  # the state of a cable servo was unknown when the phase began
        self.lagged = [0] * spools  # cycles with too large a following error
        self.person = False  # an operator released the robot, wherever it was
        self.activate()

    # --- events ----------------------------------------------------------------------------------

    @precondition(lambda self: self.alive)
    @rule(cycles=st.integers(1, 20))
    def time_passes(self, cycles: int) -> None:
        for _ in range(cycles):
            self.rig.speeds.clear()
            before, goals = self.rig.robot.player, self.goal_registers()
            seen = [self.rig.robot.actuators.track.last(s.servo) for s in self.given.spools]
            self.rig.goals.clear()
            snapshot = self.rig.run(QUICK.period)
            self.check_goals([self.clock.now if at is None else at.time for at in seen])
            if before.phase is snapshot.player.phase:
                self.check_hold(goals)
            self.check_following()
            self.check_release()
            self.check_emergency()
            phases = (before.phase, snapshot.player.phase)
            if self.is_late() or any(phase in MAY_MOVE for phase in phases):
                self.moved_until = self.clock.now
            self.check_motion()
            self.check_torques()

    @precondition(lambda self: self.alive and not self.rig.robot.active)
    @rule()
    def activate(self) -> None:
        self.try_to(lambda now: self.rig.robot.activate(now))

    @precondition(lambda self: self.alive)
    @rule(gait=GAITS, cycles=st.integers(1, 3), wait=st.integers(0, 60))
    def goal(self, gait: Gait, cycles: int, wait: int) -> None:
        gait = self.fitted(gait)
        number = self.try_to(lambda now: self.rig.robot.start(now, gait, cycles))
        if number is not None:
            self.goals.append(number)
        self.time_passes(wait)

    @precondition(lambda self: self.alive)
    @rule()
    def cancel(self) -> None:
        self.rig.robot.cancel(self.clock.now)

    @precondition(lambda self: self.alive)
    @rule(gait=GAITS, queued=st.integers(0, 3), wait=st.integers(1, 30))
    def stop(self, gait: Gait, queued: int, wait: int) -> None:
        """Stop, also with queued goals: none of them is played after the stop."""
        loop, robot, gait = self.rig.loop, self.rig.robot, self.fitted(gait)
        goals = [loop.submit(lambda now: robot.start(now, gait, 1)) for _ in range(queued)]
        loop.submit(lambda now: robot.stop(now, "stop"), lifetime=math.inf)
        self.time_passes(1)
        self.goals += [goal.result() for goal in goals if goal.exception() is None]
        for _ in range(wait):
            assert robot.player.active_run is None
            assert not gait_player.moving(robot.player) or not robot.active
            self.time_passes(1)

    @precondition(lambda self: self.alive)
    @rule(gait=GAITS, cycles=st.integers(1, 30))
    def emergency_stop(self, gait: Gait, cycles: int) -> None:
        """Nothing starts and nothing moves until the reset, also with the next driver."""
        self.latch()
        self.time_passes(cycles)
        assert self.try_to(lambda now: self.rig.robot.start(now, gait, 1)) is None
        was_active = self.rig.robot.active
        self.activate()
        assert was_active or not self.rig.robot.active

    @precondition(lambda self: self.alive and self.latched)
    @rule()
    def reset_emergency_stop(self) -> None:
        self.latched = False

    @precondition(lambda self: self.alive)
    @rule(
        stop_after=st.one_of(st.none(), st.integers(0, 120)),
        again=st.integers(0, 9),
        emergency=st.booleans(),
    )
    def signal(self, stop_after: int | None, again: int, *, emergency: bool) -> None:
        """Signal the process to end, in any state.

        A stop, an emergency stop or a second Ctrl-C may come at any time of the shutdown.
        """
        robot, stopped = self.rig.robot, False
        self.rig.loop.shutdown("the driver ends")
        end = self.clock.now + self.rest_timeout
        passed = 0
        while not self.rig.ended and self.clock.now < end:
            if passed == stop_after:
                stopped = robot.active
                if emergency:
                    self.latch()
                else:
                    self.rig.loop.submit(lambda now: robot.stop(now, "stop"), lifetime=math.inf)
            self.time_passes(1)
            assert robot.player.active_run is None or not stopped
            passed += 1
            if again == 0 and passed == 20:
                self.rig.loop.release_at_once()
                self.person = True
                break
        was_active = robot.active
        problems = self.rig.end()
        by_person = self.person  # the check below resets it
        self.check_release()
        if was_active and not by_person and self.rig.contraction > SPRINGS_BACK:
            assert problems
        if not problems:
            assert not any(self.rig.torques)
        self.restart(0.0)

    @precondition(lambda self: self.alive and self.rig.robot.active)
    @rule(max_wait=st.sampled_from([0.0, 0.1, math.inf]), again=st.booleans())
    def deactivate(self, max_wait: float, again: bool) -> None:
        self.bring_to_rest(max_wait)
        if again and self.alive and not self.rig.robot.active:
            self.activate()

    @precondition(lambda self: self.alive and self.rig.robot.active)
    @rule(fault=FAULTS, delay=st.floats(0.0, 0.5))
    def deactivate_with_a_fault_on_the_way(self, fault: tuple[str, dict], delay: float) -> None:
        self.inject(fault, delay)
        self.bring_to_rest(math.inf)

    @precondition(lambda self: self.alive and self.rig.robot.player.phase is GaitPhase.FAULT)
    @rule()
    def mend(self) -> None:
        """Recover from a fault as an operator does."""
        self.bring_to_rest(0.0)
        self.virtual.board.clear()
        if self.alive:
            self.reboot()
            self.pass_without_driver(1.0)
            self.time_passes(5)
            if not self.rig.robot.actuators.homed:
                self.home()
            self.activate()

    def bring_to_rest(self, max_wait: float) -> None:
        robot = self.rig.robot
        in_fault = robot.player.phase is GaitPhase.FAULT
        try:
            robot.ramp_to_rest(self.clock.now, "deactivated")
        except StoppedError:
            assert self.latched
            assert robot.holding
            return  # deactivate fails
        end = self.clock.now + min(max_wait, self.rest_timeout)
        while not robot.released and self.clock.now < end:
            self.time_passes(1)
        if math.isinf(max_wait) and not robot.released:
            assert robot.holding  # deactivate fails
            return
        self.person = in_fault or math.isfinite(max_wait)  # in FAULT, or not waited for
        problems = robot.release()
        self.check_release()
        assert not robot.active
        assert problems or not any(self.rig.torques)
        if problems:  # as in the node: everything is closed, and opened again
            self.restart(0.0)

    @precondition(lambda self: self.alive and not self.rig.robot.active)
    @rule()
    def home(self) -> None:
        self.try_to(lambda _: self.rig.robot.home())
        for cable in self.cables:
            if self.rig.robot.actuators.homed and cable.memory["led"]:
                assert abs(cable._encoder.raw(cable.shaft.position)) < 4096 * 2

    @precondition(lambda self: self.alive and not self.rig.robot.active)
    @rule()
    def reboot(self) -> None:
        self.person = True  # a reboot of a servo switches its torque off
        self.try_to(lambda _: self.rig.robot.reboot())
        self.check_release()

    @precondition(lambda self: self.alive)
    @rule(fault=FAULTS, delay=st.floats(0.0, 0.05))
    def fault(self, fault: tuple[str, dict], delay: float) -> None:
        self.inject(fault, delay)
        self.time_passes(10)

    @precondition(lambda self: self.alive)
    @rule(index=st.integers(0, 1), share=st.floats(0.02, 1.0), cycles=st.integers(0, 60))
    def servo_is_slowed(self, index: int, share: float, cycles: int) -> None:
        """Let another program reduce the speed of a cable servo, until the next activation."""
        slow_down(self.cables[index % len(self.cables)], share * self.given.max_cable_speed)
        self.time_passes(cycles)

    @precondition(lambda self: self.alive)
    @rule(away=st.one_of(st.floats(0.0, 0.06), st.floats(0.0, 0.5)))
    def suspended(self, away: float) -> None:
        """Suspend the driver, as on a busy computer or by a stop of the process."""
        self.pass_without_driver(away)

    @rule(away=st.floats(0.0, 0.5))
    def killed_and_started_again(self, away: float) -> None:
        self.restart(away)
        if self.alive:
            self.activate()

    def inject(self, fault: tuple[str, dict], delay: float) -> None:
        name, arguments = fault
        self.rig.advance(self.clock.now)
        self.virtual.board.add(make_fault(name, **arguments).delayed(self.clock.now + delay))
        self.troubled_until = self.clock.now + delay + arguments.get("duration", 0.4) + 1.0

    def latch(self) -> None:
        """Set the emergency stop, as the node does."""
        robot = self.rig.robot
        self.latched = True
        self.rig.loop.submit(lambda now: robot.stop(now, EMERGENCY), lifetime=math.inf)

    def why_not_start(self) -> str:
        return EMERGENCY if self.latched else ""

    # --- helpers -----------------------------------------------------------------------------------

    def fitted(self, gait: Gait) -> Gait:
        """Return a gait that a slow cable can follow, and that does not take minutes."""
        speed = self.given.max_cable_speed
        gait = replace(
            gait, stroke=min(gait.stroke, 2 * speed), pretension=min(gait.pretension, speed)
        )
        return replace(gait, frequency=gait.frequency * min(1.0, 0.95 * speed / gait.peak_speed))

    def is_late(self) -> bool:
        """Return True if a slow servo still moves to its last goal, and no hold has replaced this goal.

        A hold replaces only the goal of a servo whose state is known.
        """
        snapshots = self.rig.snapshots[-2:]
        if self.rig.robot.player.phase is not snapshots[0].player.phase:
            states = [state for s in snapshots for state in s.servos[: len(self.cables)]]
            self.unmeasured = SILENT in states
        late = any(abs(servo.motor.position - servo._goal) > 20 for servo in self.cables)
        return late and (self.unmeasured or not self.rig.robot.holding)

    def goal_registers(self) -> list[int | None]:
        """Return the goal position of each cable servo; None without torque."""
        return [
            servo.memory["goal_position"] if servo.memory["torque_enable"] else None
            for servo in self.cables
        ]

    def try_to(self, action):
        try:
            return action(self.clock.now)
        except DriverError:
            return None

    def restart(self, away: float) -> None:
        self.goals.clear()
        self.stood_at = None
        self.moved_until = max(self.moved_until, self.clock.now + QUICK.watchdog)
        self.pass_without_driver(away)
        for _ in range(3):
            try:
                self.rig = Rig(self.given, self.virtual, self.clock, self.why_not_start)
            except DriverError:
                self.pass_without_driver(1.0)
            else:
                self.alive = True
                return
        self.alive = False  # a servo that shut down needs its operator

    def pass_without_driver(self, duration: float) -> None:
        self.rig.speeds.clear()
        self.clock.now += duration
        self.rig.advance(self.clock.now)
        self.check_motion(whole=False)

    # --- invariants ------------------------------------------------------------------------------------

    def check_goals(self, seen: list[float]) -> None:
        """Assert that each goal is within the stroke, and within reach of the cable's last valid position.

        ``seen`` are the times of these positions in s.
        """
        if not self.rig.robot.active:
            return
        for spool, time, servo in zip(self.given.spools, seen, self.cables, strict=True):
            for goal in self.rig.goals if servo.memory["torque_enable"] else ():
                if goal.servo != spool.servo:
                    continue
                assert -QUICK.max_stroke - SLACK <= spool.length_change(goal.ticks) <= SLACK
                unseen = max(0.0, goal.time - time - QUICK.period)
                # the cable has moved since its last valid position, which may have a small error itself
                assert goal.distance <= REACH + 2 * unseen * QUICK.max_cable_speed + OFF, goal

    def check_hold(self, before: list[int | None]) -> None:
        """Assert that in a hold, in which no command but a stop came, no goal changes."""
        robot = self.rig.robot
        if robot.active and robot.holding:
            for then, now in zip(before, self.goal_registers(), strict=True):
                assert now == then or None in (then, now), robot.player

    def check_following(self) -> None:
        """Assert that every servo is within its own following error, or that there is a FAULT."""
        robot = self.rig.robot
        watched = robot.active and robot.player.phase is not GaitPhase.FAULT
        lengths = shaft_lengths(self.rig)
        for index, (spool, servo) in enumerate(zip(self.given.spools, self.cables, strict=True)):
            off = abs(lengths[index] - spool.length_change(servo.memory["goal_position"]))
            lags = watched and off > QUICK.max_following_error + OFF
            self.lagged[index] = self.lagged[index] + 1 if lags else 0
        assert max(self.lagged) <= LAGGED or self.clock.now <= self.troubled_until, robot.player

    def check_release(self) -> None:
        """Assert that a contracted robot keeps its torque.

        Only an operator, who gets a message, or a servo that shuts down or restarts, may switch it off.
        """
        holds = tuple(bool(servo.memory["torque_enable"]) for servo in self.cables)
        booted = tuple(servo._booted_at for servo in self.cables)
        states = zip(self.cables, self.held, holds, self.booted, booted, strict=False)
        released = any(
            held and not hold and then == now and not servo._shut_down
            for servo, held, hold, then, now in states
        )
        if released and self.rig.contraction > SPRINGS_BACK:
            robot = self.rig.robot
            assert self.person, robot.player
            assert (
                robot.actuators.sprung_back
                or not robot.actuators.homed
                or self.clock.now <= self.troubled_until
            ), robot.player
        self.held, self.booted, self.person = holds, booted, False

    def check_emergency(self) -> None:
        """Assert that from the cycle after an emergency stop on, the robot holds or has no torque."""
        if self.latched and self.rig.robot.active:
            assert self.rig.robot.player.phase in (GaitPhase.HOLDING, GaitPhase.FAULT)

    def check_motion(self, *, whole: bool = True) -> None:
        """Assert that no cable is too fast, and that a standing one only creeps."""
        fastest = max((speed for _, speed in self.rig.speeds), default=0.0)
        if not all(servo.memory["torque_enable"] for servo in self.cables):
            self.stood_at = None
            return
        assert fastest <= self.given.max_cable_speed * OVERSHOOT + 0.002, f"{fastest} m/s"
        if not whole or self.clock.now <= self.moved_until + BRAKING:
            self.stood_at = None
            return
        here = [servo.motor.position for servo in self.cables]
        if self.stood_at is None:
            self.stood_at = here
        crept = max(
            abs(spool.length_change(now - then))
            for spool, now, then in zip(self.given.spools, here, self.stood_at, strict=True)
        )
        assert crept <= CREEP, (self.rig.robot.player, crept)

    def check_torques(self) -> None:
        robot = self.rig.robot
        if not robot.active and not robot.actuators.unreleased and not robot.actuators.left_on:
            assert not any(self.rig.torques)
        if robot.active and self.clock.now > self.troubled_until:
            assert all(self.rig.torques) or robot.player.phase is GaitPhase.FAULT

    @invariant()
    def torque_is_off_or_the_watchdog_armed_or_expired(self) -> None:
        for servo in self.virtual.servos:
            assert not servo.memory["torque_enable"] or servo.memory["bus_watchdog"] != 0

    @invariant()
    def no_goal_lies_beyond_the_range(self) -> None:
        if not self.alive or not self.rig.robot.active:
            return
        for spool, cable in zip(self.given.spools, self.cables, strict=True):
            if cable.memory["torque_enable"] and self.rig.robot.actuators.homed:
                change = spool.length_change(cable.memory["goal_position"])
                assert -QUICK.max_stroke - SLACK <= change <= SLACK

    @invariant()
    def every_goal_but_the_last_has_its_result(self) -> None:
        if self.alive and self.goals:
            run = self.rig.robot.player.run
            assert run is not None
            assert run.number == self.goals[-1]
            assert self.rig.robot.active or run.ending is not None

    def teardown(self) -> None:
        """Wait until the last goal ends without further requests."""
        if not getattr(self, "alive", False) or not self.goals:
            return
        self.virtual.board.clear()
        self.troubled_until = math.inf
        end = self.clock.now + 40.0
        while self.rig.robot.player.active_run is not None and self.clock.now < end:
            self.time_passes(5)
        assert self.rig.robot.player.active_run is None


@pytest.mark.timeout(900)  # each part takes minutes of the virtual clock
@pytest.mark.parametrize(  # of a thousand steps each
    "part", [0, *(pytest.param(part, marks=pytest.mark.night) for part in range(1, 10))]
)
def test_whatever_happens(part: int) -> None:
    seed(part)(Life)
    run_state_machine_as_test(
        Life,
        settings=hypothesis_settings(
            max_examples=LIVES,
            stateful_step_count=STEPS,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        ),
    )
