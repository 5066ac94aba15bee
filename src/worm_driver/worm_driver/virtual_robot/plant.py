# SPDX-License-Identifier: Apache-2.0
"""The worm in its pipe: fixed-step integration of the two-mass model and of what it leaves out.

The model's part follows the paper (eq:x1_ddot_full to eq:power_model) with parameters of its own.
Beyond it: dry friction of both modules, fins whose threshold and stiffness differ from groove to groove, and,
if it is asked for, a cable that gives: then its force drives the two masses, and load changes the length, which the
model takes from the command alone. SI units; forward is +x; contraction is negative.

The state keeps the centre of mass, y = x1 + M2/(M1+M2)*(L - L0): adding eq:x1_ddot_full and
eq:x2_ddot_full leaves no second derivative of the length in its equation of motion.
"""

import math
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

FORWARD = 1
REVERSE = -1
LOOSE = 0  # the fins stand in between: neither bar touches the wall

_GROOVES = 512  # number of different grooves before their scatter repeats
_SLOW = 1e-3  # m/s below which dry friction fades, so that rest is rest


@dataclass(frozen=True)
class BodyParameters:
    """True values of the paper's parameters, under its keys (see the parameter file)."""

    rear_mass: float
    front_mass: float
    unstressed_length: float
    initial_length: float
    bellows_stiffness: float
    bellows_damping: float
    viscous_friction: float
    pitch: float
    engaged_stiffness: float
    disengaged_stiffness: float
    switching_threshold: float
    clearance: float
    time_constant: float
    gain: float
    slack: float
    idle_power: float
    power_factor: float


@dataclass(frozen=True)
class PlantEffects:
    """What the model leaves out.

    dry_friction: N for each module. threshold_scatter: m, standard deviation of the switching
    threshold from groove to groove. stiffness_scatter: relative standard deviation of the fins'
    stiffness. The transmission takes its slack up when the cable is first pulled beyond
    slack_engagement (m), and gives it back when the cable rests for slack_release (s).
    cable_stiffness: N/m, of the cable with its servo and transmission, pulled at the modules; such a cable
    cannot push. The body's gain and time constant then have no meaning: k_cable/(k_cable + k_b) and
    c_b/(k_cable + k_b) take their place. 0: the length follows the command alone, as in the paper.
    """

    dry_friction: float
    threshold_scatter: float
    stiffness_scatter: float
    slack_engagement: float
    slack_release: float
    cable_stiffness: float = 0.0


class Grooves(NamedTuple):
    """Scatter of the grooves that one fin pair sees: thresholds (m) and stiffness factors."""

    thresholds: tuple[float, ...]
    stiffness: tuple[float, ...]


class PlantState(NamedTuple):
    """State of the worm; lengths are changes from the initial length.

    rear_groove and front_groove count anchors in pitches; slack_taken tells whether the
    transmission's slack is taken up; cable_rest is how long (s) the cable has been still at its
    start; cable_force (N) is positive when the cable pulls; mechanical_power (W) is what the
    cable puts in, never negative.
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


def make_grooves(parameters: BodyParameters, effects: PlantEffects, seed: int) -> Grooves:
    """The scatter of a pipe, from a seed."""
    random = Random(seed)
    mean = parameters.switching_threshold
    thresholds = tuple(random.gauss(mean, effects.threshold_scatter) for _ in range(_GROOVES))
    stiffness = tuple(
        max(random.gauss(1.0, effects.stiffness_scatter), 0.1) for _ in range(_GROOVES)
    )
    return Grooves(thresholds, stiffness)


@dataclass(frozen=True)
class Plant:
    """A worm in a pipe. step_s: s, 1 ms or finer."""

    parameters: BodyParameters
    effects: PlantEffects
    rear_grooves: Grooves
    front_grooves: Grooves
    step_s: float

    def at_rest(self) -> PlantState:
        """The start: x1 = 0, both anchors in the grooves nearest to their fins."""
        p = self.parameters
        front = round(p.initial_length / p.pitch)
        force = p.bellows_stiffness * (p.unstressed_length - p.initial_length)
        return PlantState(0.0, 0.0, 0.0, 0.0, 0, front, False, 0.0, force, 0.0)

    def put_back(self, state: PlantState) -> PlantState:
        """A worm, however long it is, that somebody has put where it started, its fins straight."""
        p = self.parameters
        share = p.front_mass / (p.rear_mass + p.front_mass)
        return state._replace(
            centre=share * state.length_change,
            centre_velocity=share * state.length_rate,
            rear_groove=0,
            front_groove=round((p.initial_length + state.length_change) / p.pitch),
        )

    def positions(self, state: PlantState) -> tuple[float, float]:
        """x1 and x2 (m)."""
        p = self.parameters
        share = p.front_mass / (p.rear_mass + p.front_mass)
        rear = state.centre - share * state.length_change
        return rear, rear + p.initial_length + state.length_change

    def step(self, state: PlantState, cable: float, laws: tuple[int, int]) -> PlantState:
        """The state a step later.

        cable: m, what the servos have wound of the cable since the start, contraction negative.
        laws: direction in which the rear and the front fins let the robot slide.
        """
        if self.effects.cable_stiffness > 0.0:
            return self._pulled(state, cable, laws)
        p = self.parameters
        taken, cable_rest = self._slack(state, cable)
        length_change, length_rate = self._actuate(state.length_change, cable, taken=taken)
        x1, x2 = self.positions(state)
        rear_groove, rear_force = self._fin(x1, state.rear_groove, laws[0], self.rear_grooves)
        front_groove, front_force = self._fin(x2, state.front_groove, laws[1], self.front_grooves)
        velocity, drag1 = self._push(state, length_rate, rear_force + front_force)
        share = p.front_mass / (p.rear_mass + p.front_mass)
        v1 = velocity - share * length_rate
        v1_before = state.centre_velocity - share * state.length_rate
        force = (  # eq:Fc
            p.rear_mass * (v1 - v1_before) / self.step_s
            + p.bellows_stiffness * (p.unstressed_length - p.initial_length - length_change)
            - p.bellows_damping * length_rate
            + drag1 * v1
            + rear_force
        )
        return PlantState(
            length_change,
            length_rate,
            state.centre + self.step_s * velocity,
            velocity,
            rear_groove,
            front_groove,
            taken,
            cable_rest,
            force,
            max(-force * length_rate, 0.0),
        )

    def electrical_power(self, state: PlantState) -> float:
        """Power (W) at the source (eq:power_model), without noise."""
        return self.parameters.idle_power + self.parameters.power_factor * state.mechanical_power

    def _pulled(self, state: PlantState, cable: float, laws: tuple[int, int]) -> PlantState:
        """The state a step later of two masses that a cable's force pulls together (eq:x1_ddot_full, eq:x2_ddot_full).

        Springs, dampers and frictions enter implicitly. A cable that would push is slack, and its force nothing.
        """
        p, h = self.parameters, self.step_s
        taken, cable_rest = self._slack(state, cable)
        x1, x2 = self.positions(state)
        rear_groove, rear_force = self._fin(x1, state.rear_groove, laws[0], self.rear_grooves)
        front_groove, front_force = self._fin(x2, state.front_groove, laws[1], self.front_grooves)
        share = p.front_mass / (p.rear_mass + p.front_mass)
        v1 = state.centre_velocity - share * state.length_rate
        v2 = v1 + state.length_rate
        rear = p.rear_mass / h, p.rear_mass * v1 / h - rear_force, self._drag(v1)
        front = p.front_mass / h, p.front_mass * v2 / h - front_force, self._drag(v2)
        preload = p.bellows_stiffness * (p.unstressed_length - p.initial_length)
        bellows = p.bellows_stiffness * state.length_change - preload
        stiffness = self.effects.cable_stiffness
        pull = preload + stiffness * (state.length_change - min(cable, -p.slack if taken else 0.0))
        for held, k in ((pull, stiffness), (0.0, 0.0)):  # taut, else slack
            inner = (k + p.bellows_stiffness) * h + p.bellows_damping
            a1, a2 = rear[0] + rear[2] + inner, front[0] + front[2] + inner
            b1, b2 = rear[1] + held + bellows, front[1] - held - bellows
            determinant = a1 * a2 - inner * inner
            v1, v2 = (b1 * a2 + b2 * inner) / determinant, (b2 * a1 + b1 * inner) / determinant
            force = held + k * h * (v2 - v1)
            if force >= 0.0:
                break
        rate = v2 - v1
        velocity = v1 + share * rate
        return PlantState(
            state.length_change + h * rate,
            rate,
            state.centre + h * velocity,
            velocity,
            rear_groove,
            front_groove,
            taken,
            cable_rest,
            force,
            max(-force * rate, 0.0),
        )

    def _drag(self, velocity: float) -> float:
        """Friction over velocity, viscous and dry, N·s/m."""
        return self.parameters.viscous_friction + self.effects.dry_friction / (
            abs(velocity) + _SLOW
        )

    def _slack(self, state: PlantState, cable: float) -> tuple[bool, float]:
        if cable < -self.effects.slack_engagement:
            return True, 0.0
        cable_rest = state.cable_rest + self.step_s
        return state.slack_taken and cable_rest < self.effects.slack_release, cable_rest

    def _actuate(self, length_change: float, cable: float, *, taken: bool) -> tuple[float, float]:
        """Length change and its rate a step later (eq:slack_clip, eq:first_order_actuation)."""
        p = self.parameters
        effective = min(cable, -p.slack if taken else 0.0)
        goal = p.gain * effective
        new = goal + (length_change - goal) * math.exp(-self.step_s / p.time_constant)
        return new, (goal - new) / p.time_constant

    def _push(
        self, state: PlantState, length_rate: float, fin_forces: float
    ) -> tuple[float, float]:
        """Velocity of the centre of mass a step later, and the drag (N*s/m) on the rear module.

        Both frictions, viscous and dry, enter implicitly: no step is too long for them.
        """
        p = self.parameters
        mass = p.rear_mass + p.front_mass
        share = p.front_mass / mass
        v1 = state.centre_velocity - share * length_rate
        v2 = v1 + length_rate
        drag1, drag2 = self._drag(v1), self._drag(v2)
        pull = (drag1 * share - drag2 * (1.0 - share)) * length_rate - fin_forces
        inertia = mass / self.step_s
        velocity = (inertia * state.centre_velocity + pull) / (inertia + drag1 + drag2)
        return velocity, drag1

    def _fin(self, x: float, groove: int, law: int, grooves: Grooves) -> tuple[int, float]:
        """Groove of the anchor (eq:A1_switch) and force on the fin (eq:fin_force_piecewise)."""
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
