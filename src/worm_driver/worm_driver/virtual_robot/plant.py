# SPDX-License-Identifier: Apache-2.0
"""Plant of the virtual robot: fixed-step integration of the two-mass model with loads and additional effects.

The model follows the paper (eq:x1_ddot_full to eq:power_model). Additional effects are dry friction of both modules,
fins whose threshold and stiffness differ from groove to groove, and optionally a compliant cable. The force of a
compliant cable drives the two masses, so loads change the body length. In the paper's model the length depends on the
command alone. The weight of the modules in a sloping pipe, the pull of a tether and the drag of flowing water load the
robot along the pipe. SI units; forward is +x; contraction is negative; a positive load acts towards -x.

The state contains the displacement of the centre of mass, y = x1 + M2/(M1+M2)*(L - L0), with the masses M1 and M2 of
the rear and the front module. The equation of motion of y is the sum of eq:x1_ddot_full and eq:x2_ddot_full, which
contains no second derivative of the length.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from random import Random
from typing import Annotated, NamedTuple

from worm_msgs.conditions import LEVEL, Conditions
from worm_msgs.gait import FORWARD
from worm_msgs.robot_parameters import RobotParameters
from worm_msgs.settings_file import key

LOOSE = 0  # the fins are between their two angles: neither bar touches the wall

_GROOVES = 512  # number of different grooves; then they repeat
# m/s; at lower speeds dry friction decreases to 0. So a loaded robot at rest creeps at a speed of this order.
_SLOW = 1e-6
# The fins count as holding a loaded robot if it slows down to _SETTLED within the time _SETTLING, and moves by at most
# _HELD.
_SETTLING = 600.0  # s
_SETTLING_STEP = 0.01  # s; the explicit integration of the fin forces is stable up to about 50 ms
_SETTLED = 1e-7  # m/s
_HELD = 2  # grooves


@dataclass(frozen=True)
class PlantEffects:
    """Effects that the paper's model does not contain.

    Attributes:
        threshold_scatter: standard deviation of the switching threshold from groove to groove, m.
        stiffness_scatter: relative standard deviation of the fin stiffness from groove to groove.
        slack_engagement: contraction of the cable beyond which the slack is taken up, m.
        slack_release: time without such a contraction after which the slack returns, s.
        cable_stiffness: stiffness k_cable of cable, servo and transmission together, N/m; 0 means rigid, as in the
            paper. A compliant cable cannot push. It replaces the parameters gain and time constant by
            k_cable/(k_cable + k_b) and c_b/(k_cable + k_b), with the stiffness k_b and the damping c_b of the bellows.
    """

    threshold_scatter: Annotated[float, key("threshold_scatter_m", ge=0.0)]
    stiffness_scatter: Annotated[float, key(ge=0.0)]
    slack_engagement: Annotated[float, key("slack_engagement_m", ge=0.0)]
    slack_release: Annotated[float, key("slack_release_s", ge=0.0)]
    cable_stiffness: Annotated[float, key("cable_stiffness_N_per_m", ge=0.0)] = 0.0


class Grooves(NamedTuple):
    """Switching thresholds (m) and stiffness factors of the grooves, for the fins of one module."""

    thresholds: tuple[float, ...]
    stiffness: tuple[float, ...]


class PlantState(NamedTuple):
    """State of the plant.

    Attributes:
        length_change: body length minus the initial length, m.
        length_rate: derivative of the length change, m/s.
        centre: centre of mass coordinate y, m.
        centre_velocity: derivative of y, m/s.
        rear_groove, front_groove: anchors A1 and A2, divided by the pitch.
        slack_taken: True while the slack of the transmission is taken up.
        cable_rest: time since the cable was last contracted by more than slack_engagement, s.
        cable_force: cable force, N; positive when the cable pulls.
        mechanical_power: power of the cable, W; never negative.
    """

    length_change: float
    length_rate: float
    centre: float
    centre_velocity: float
    rear_groove: int
    front_groove: int
    slack_taken: bool
    cable_rest: float
    cable_force: float
    mechanical_power: float


def make_grooves(parameters: RobotParameters, effects: PlantEffects, seed: int) -> Grooves:
    """Return random grooves for a seed."""
    random = Random(seed)
    mean = parameters.switching_threshold
    thresholds = tuple(random.gauss(mean, effects.threshold_scatter) for _ in range(_GROOVES))
    stiffness = tuple(
        max(random.gauss(1.0, effects.stiffness_scatter), 0.1) for _ in range(_GROOVES)
    )
    return Grooves(thresholds, stiffness)


@dataclass(frozen=True)
class Plant:
    """Robot in a pipe.

    Attributes:
        parameters: parameters of the body.
        effects: effects that the paper's model does not contain.
        rear_grooves, front_grooves: properties of the grooves for the rear and for the front fins.
        step_s: step of the integration, s.
        conditions: loads along the pipe.
    """

    parameters: RobotParameters
    effects: PlantEffects
    rear_grooves: Grooves
    front_grooves: Grooves
    step_s: float
    conditions: Conditions = LEVEL

    @cached_property
    def _share(self) -> float:
        """Mass of the front module divided by the total mass."""
        return self.parameters.front_mass / (self.parameters.rear_mass + self.parameters.front_mass)

    @cached_property
    def _decay(self) -> float:
        """Factor by which the difference between length change and target decreases in one step."""
        return math.exp(-self.step_s / self.parameters.time_constant)

    @cached_property
    def _unloaded(self) -> bool:
        """True if no load acts on the robot, at any position."""
        p = self.parameters
        return self.conditions == LEVEL and p.rear_load == p.front_load == 0.0

    def at_rest(self, laws: tuple[int, int] = (FORWARD, FORWARD)) -> PlantState:
        """Return the initial state.

        Without a load, x1 is 0, and both anchors are in the grooves nearest to their fins. Under a load, the initial
        state is the equilibrium that the robot reaches from this state. If the fins do not hold the robot, the initial
        state is that without a load, and the robot slides from it.

        Args:
            laws: directions in which the rear and the front fins slide (FORWARD, REVERSE or LOOSE).
        """
        p = self.parameters
        front = round(p.initial_length / p.pitch)
        force = p.bellows_stiffness * (p.unstressed_length - p.initial_length)
        start = PlantState(0.0, 0.0, 0.0, 0.0, 0, front, False, 0.0, force, 0.0)
        if self._loads(0.0, 0.0, 0.0) == (0.0, 0.0):
            return start
        state, plant = start, replace(self, step_s=_SETTLING_STEP)
        for _ in range(round(_SETTLING / _SETTLING_STEP)):
            state = plant.step(state, 0.0, laws)
            if abs(state.centre_velocity) + abs(state.length_rate) <= _SETTLED:
                return state._replace(
                    length_rate=0.0, centre_velocity=0.0, cable_rest=0.0, mechanical_power=0.0
                )
            if abs(state.centre) > _HELD * p.pitch:
                break
        return start

    def put_back(self, state: PlantState) -> PlantState:
        """Return the state after the robot was put back to its start, with each fin in its nearest groove.

        The length does not change.
        """
        p, share = self.parameters, self._share
        return state._replace(
            centre=share * state.length_change,
            centre_velocity=share * state.length_rate,
            rear_groove=0,
            front_groove=round((p.initial_length + state.length_change) / p.pitch),
        )

    def positions(self, state: PlantState) -> tuple[float, float]:
        """Return x1 and x2 (m)."""
        rear = state.centre - self._share * state.length_change
        return rear, rear + self.parameters.initial_length + state.length_change

    def step(self, state: PlantState, cable: float, laws: tuple[int, int]) -> PlantState:
        """Return the state one step later.

        Args:
            state: the present state.
            cable: cable displacement since the start, m; contraction is negative.
            laws: directions in which the rear and the front fins slide (FORWARD, REVERSE or LOOSE).
        """
        taken, cable_rest = self._slack(state, cable)
        x1, x2 = self.positions(state)
        rear_groove, rear_force = self._fin(x1, state.rear_groove, laws[0], self.rear_grooves)
        front_groove, front_force = self._fin(x2, state.front_groove, laws[1], self.front_grooves)
        v1 = state.centre_velocity - self._share * state.length_rate
        rear_load, front_load = self._loads(x1, v1, v1 + state.length_rate)
        forces = rear_force + rear_load, front_force + front_load
        wound = min(cable, -self.parameters.slack if taken else 0.0)
        move = self._pulled if self.effects.cable_stiffness > 0.0 else self._commanded
        length_change, length_rate, velocity, cable_force = move(state, wound, forces)
        return PlantState(
            length_change,
            length_rate,
            state.centre + self.step_s * velocity,
            velocity,
            rear_groove,
            front_groove,
            taken,
            cable_rest,
            cable_force,
            max(-cable_force * length_rate, 0.0),
        )

    def electrical_power(self, state: PlantState) -> float:
        """Return the power (W) at the source (eq:power_model), without noise."""
        return self.parameters.idle_power + self.parameters.power_factor * state.mechanical_power

    def _commanded(
        self, state: PlantState, wound: float, forces: tuple[float, float]
    ) -> tuple[float, float, float, float]:
        """Return length change, its rate, velocity of the centre and cable force one step later, with a rigid cable.

        The length depends on the command alone (eq:slack_clip, eq:first_order_actuation). Friction and drag are
        integrated implicitly, which is stable for any step.

        Args:
            state: the present state.
            wound: cable displacement without the slack, m.
            forces: fin force and load of the rear and the front module, N, positive towards -x.
        """
        p, share = self.parameters, self._share
        goal = p.gain * wound
        length_change = goal + (state.length_change - goal) * self._decay
        length_rate = (goal - length_change) / p.time_constant
        v1 = state.centre_velocity - share * length_rate
        drag1, drag2 = self._drags(v1, v1 + length_rate)
        pull = (drag1 * share - drag2 * (1.0 - share)) * length_rate - (forces[0] + forces[1])
        inertia = (p.rear_mass + p.front_mass) / self.step_s
        velocity = (inertia * state.centre_velocity + pull) / (inertia + drag1 + drag2)
        v1_before = state.centre_velocity - share * state.length_rate
        v1 = velocity - share * length_rate
        cable_force = (  # eq:Fc
            p.rear_mass * (v1 - v1_before) / self.step_s
            + p.bellows_stiffness * (p.unstressed_length - p.initial_length - length_change)
            - p.bellows_damping * length_rate
            + drag1 * v1
            + forces[0]
        )
        return length_change, length_rate, velocity, cable_force

    def _pulled(
        self, state: PlantState, wound: float, forces: tuple[float, float]
    ) -> tuple[float, float, float, float]:
        """Return the same as `_commanded`, with a compliant cable (eq:x1_ddot_full, eq:x2_ddot_full).

        Cable, bellows and friction are integrated implicitly, the fin forces explicitly. A cable that would have to
        push is slack: its force is zero.
        """
        p, h, share = self.parameters, self.step_s, self._share
        v1 = state.centre_velocity - share * state.length_rate
        v2 = v1 + state.length_rate
        drag1, drag2 = self._drags(v1, v2)
        rear = p.rear_mass / h, p.rear_mass * v1 / h - forces[0], drag1
        front = p.front_mass / h, p.front_mass * v2 / h - forces[1], drag2
        preload = p.bellows_stiffness * (p.unstressed_length - p.initial_length)
        bellows = p.bellows_stiffness * state.length_change - preload
        stiffness = self.effects.cable_stiffness
        pull = preload + stiffness * (state.length_change - wound)
        for held, k in ((pull, stiffness), (0.0, 0.0)):  # first a taut cable, then a slack one
            inner = (k + p.bellows_stiffness) * h + p.bellows_damping
            a1, a2 = rear[0] + rear[2] + inner, front[0] + front[2] + inner
            b1, b2 = rear[1] + held + bellows, front[1] - held - bellows
            determinant = a1 * a2 - inner * inner
            v1, v2 = (b1 * a2 + b2 * inner) / determinant, (b2 * a1 + b1 * inner) / determinant
            cable_force = held + k * h * (v2 - v1)
            if cable_force >= 0.0:
                break
        rate = v2 - v1
        return state.length_change + h * rate, rate, v1 + share * rate, cable_force

    def _loads(self, x1: float, v1: float, v2: float) -> tuple[float, float]:
        """Return the loads of the rear and the front module (N).

        They contain the part of the drag that is proportional to the velocity of the water. `_drags` contains the part
        that is proportional to the velocity of the modules.

        Args:
            x1: position of the rear module, m.
            v1, v2: velocities of the rear and the front module, m/s.
        """
        if self._unloaded:
            return 0.0, 0.0
        p, around = self.parameters, self.conditions
        weight, flow = around.gravity, around.flow_m_per_s
        rear = p.rear_mass * weight + around.tether(x1)
        front = p.front_mass * weight
        return (
            rear + p.rear_load + around.drag(v1) * flow,
            front + p.front_load + around.drag(v2) * flow,
        )

    def _drags(self, v1: float, v2: float) -> tuple[float, float]:
        """Return friction and drag of each module, divided by its velocity, N·s/m; see `_loads`."""
        p, drag = self.parameters, self.conditions.drag
        return (
            p.viscous_friction + p.rear_dry_friction / (abs(v1) + _SLOW) + drag(v1),
            p.viscous_friction + p.front_dry_friction / (abs(v2) + _SLOW) + drag(v2),
        )

    def _slack(self, state: PlantState, cable: float) -> tuple[bool, float]:
        if cable < -self.effects.slack_engagement:
            return True, 0.0
        cable_rest = state.cable_rest + self.step_s
        return state.slack_taken and cable_rest < self.effects.slack_release, cable_rest

    def _fin(self, x: float, groove: int, law: int, grooves: Grooves) -> tuple[int, float]:
        """Return the anchor's groove (eq:A1_switch) and the fin force in N (eq:fin_force_piecewise)."""
        p = self.parameters
        if law == LOOSE:
            return round(x / p.pitch), 0.0
        deflection = x - groove * p.pitch
        index = groove % _GROOVES
        if deflection > grooves.thresholds[index]:
            groove += 1
        elif deflection < -grooves.thresholds[index]:
            groove -= 1
        deflection = x - groove * p.pitch
        half = 0.5 * p.clearance
        if -half <= deflection <= half:
            return groove, 0.0
        # Forward fins are stiff when pushed backward, reverse fins when pushed forward.
        stiff = law * deflection < 0
        stiffness = p.engaged_stiffness if stiff else p.disengaged_stiffness
        excess = deflection - math.copysign(half, deflection)
        return groove, stiffness * grooves.stiffness[groove % _GROOVES] * excess
