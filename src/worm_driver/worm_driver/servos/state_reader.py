# SPDX-License-Identifier: Apache-2.0
"""Reader of the states of all servos, once per cycle. It checks that answers are fresh and positions are plausible."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from worm_driver.servos import tick_clock
from worm_driver.servos.position_track import PositionTrack
from worm_driver.servos.registers import COMMON, WATCHDOG_EXPIRED, ServoModel
from worm_driver.servos.servo_bus import Reply, ServoBus, error_text
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.tick_clock import TickClock

#: Block that is read in every cycle: Realtime Tick to Present Temperature. No model has a gap in this range.
STATE_START = COMMON["realtime_tick"].address
STATE_SIZE = COMMON["present_temperature"].end - STATE_START


@dataclass(frozen=True)
class ServoState:
    """State of a servo, in SI units.

    Attributes:
        ticks: present position, raw.
        position: present position, rad.
        velocity: present velocity, rad/s.
        effort: current, A; for a servo that measures no current, the load as a ratio of its maximum.
        voltage: supply voltage, V.
        temperature: temperature, degC.
        tick: time of the servo's own clock (realtime_tick), s.
        trajectory: present point of the servo's profile (position_trajectory), raw. The servo controls its position to
            this point. Under a load it remains behind it.
    """

    ticks: int
    position: float
    velocity: float
    effort: float
    voltage: float
    temperature: float
    tick: float
    trajectory: int = 0


#: State of a servo without a usable answer.
SILENT = ServoState(0, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan)


def decode(model: ServoModel, block: bytes) -> ServoState:
    """Return a servo's state from its block of STATE_SIZE bytes at address STATE_START."""

    def value(name: str) -> float:
        return model[name].from_raw(model[name].unpack_from(block, STATE_START))

    position = model["present_position"]
    ticks = position.unpack_from(block, STATE_START)
    return ServoState(
        ticks=ticks,
        position=position.from_raw(ticks),
        velocity=value("present_velocity"),
        effort=value("present_current" if model.measures_current else "present_load"),
        voltage=value("present_input_voltage"),
        temperature=value("present_temperature"),
        tick=value("realtime_tick"),
        trajectory=model["position_trajectory"].unpack_from(block, STATE_START),
    )


#: Health registers, which are not part of the block of the state. In each cycle in which all states arrive, the next of
#: these registers is read from all servos.
_HEALTH = tuple(COMMON[name] for name in ("torque_enable", "hardware_error_status", "bus_watchdog"))

#: Addresses of the block that contains a servo's health registers and its clock.
_HEALTH_START, _HEALTH_END = COMMON["torque_enable"].address, COMMON["realtime_tick"].end
#: Number of exchanges from which the first estimate of a servo's clock is made.
_FIRST_ANSWERS = 3


class StateReader:
    """Reader of states.

    If an answer is missing, garbled, late, implausible or has an error number, the reader requests all states once
    more.

    Args:
        bus: open servo bus.
        servos: servos whose states are read.
        track: decides which positions are plausible.

    Attributes:
        problems: reasons why states are SILENT, by servo id.
    """

    def __init__(self, bus: ServoBus, servos: Sequence[Servo], track: PositionTrack):
        self._bus = bus
        self._track = track
        self._implausible: dict[int, int] = {}
        self._servos = tuple(servos)
        self._clocks: dict[int, TickClock] = {}
        self._suspects: set[int] = set()
        self._alerts: set[int] = set()
        self._turn = 0
        self.problems: dict[int, str] = {}
        self.learn_clocks()

    def read(self) -> tuple[float, tuple[ServoState, ...]]:
        """Return the time of the request (s, monotonic) and the states, in the order of the servos.

        The state of a servo without a fresh and plausible answer is SILENT. A servo whose position is lost
        (`PositionTrack.lost`) gets no request. The bus watchdog then stops this servo where it is, whatever its goal.
        """
        requested_at, states = self._request()
        if len(states) < len(self._ids):
            before = frozenset(self._implausible)
            self._bus.require_quiet_line()
            requested_at, states = self._request()
            for servo in before & self._implausible.keys():
                self._track.mark_lost(servo, self._implausible[servo])
        if len(states) == len(self._ids):
            self._read_health()
        return requested_at, tuple(states.get(servo.number, SILENT) for servo in self._servos)

    @property
    def _ids(self) -> list[int]:
        """Ids of the servos that get requests."""
        lost = self._track.lost
        return [servo.number for servo in self._servos if servo.number not in lost]

    def pop_suspect(self) -> int | None:
        """Remove and return the id of a servo that showed a sign of a fault or a restart; None if there is none.

        A sign does not prove a fault, because a late answer can also cause it. The caller reads the servo again.
        """
        return self._suspects.pop() if self._suspects else None

    def forget_suspects(self) -> None:
        """Drop the signs collected so far."""
        self._suspects.clear()

    @property
    def alerts(self) -> frozenset[int]:
        """Ids of the servos whose last answer reported a hardware error."""
        return frozenset(self._alerts)

    def learn_clocks(self) -> None:
        """Estimate the servos' clocks from scratch. Each request waits until no older answer can arrive.

        The signs of faults and restarts collected so far are dropped, see `pop_suspect`.
        """
        self._clocks.clear()
        with self._bus.retrying():
            for _ in range(_FIRST_ANSWERS):
                self._bus.require_quiet_line()
                self._request()
        self.forget_suspects()

    def reread_health(self, servo: Servo, names: Sequence[str]) -> Mapping[str, int] | None:
        """Return raw values of a servo's health registers ``names``, read on a quiet line; None without a fresh answer.

        A line is quiet when all older answers have arrived or can no longer arrive. The registers and the servo's clock
        are read in one block, which shows a late answer, so that it is never mistaken for a fault.
        The result includes the clock, realtime_tick.
        """
        self._bus.require_quiet_line()
        size = _HEALTH_END - _HEALTH_START
        requested_at, replies = self._bus.sync_read(_HEALTH_START, size, [servo.number])
        reply = replies.get(servo.number)
        if reply is None or reply.error:
            return None
        values = {
            name: servo[name].unpack_from(reply.data, _HEALTH_START)
            for name in ("realtime_tick", *names)
        }
        tick = servo["realtime_tick"].from_raw(values["realtime_tick"])
        return None if self._why_stale(servo.number, requested_at, reply.received, tick) else values

    def _request(self) -> tuple[float, Mapping[int, ServoState]]:
        ids = self._ids
        requested_at, replies = self._bus.sync_read(STATE_START, STATE_SIZE, ids)
        self._note_alerts(replies)
        states = {}
        self.problems.clear()
        self._implausible.clear()
        for servo in self._servos:
            reply = replies.get(servo.number)
            if servo.number not in ids:
                self.problems[servo.number] = "reported a position that it cannot have reached"
            elif reply is None:
                self.problems[servo.number] = self._bus.why_no_answer(servo.number)
            elif reply.error:
                self.problems[servo.number] = error_text(reply.error)
            else:
                state = decode(servo.model, reply.data)
                if why := self._why_stale(servo.number, requested_at, reply.received, state.tick):
                    self.problems[servo.number] = why
                elif not self._track.record_if_plausible(servo.number, state.ticks, reply.received):
                    self._note_implausible(servo.number, state.ticks)
                else:
                    states[servo.number] = state
        return requested_at, states

    def _note_implausible(self, servo: int, ticks: int) -> None:
        self._bus.count(implausible=1)
        self._implausible[servo] = ticks
        self.problems[servo] = f"reports a position that it cannot have reached ({ticks} ticks)"

    def _why_stale(self, servo: int, requested_at: float, received: float, tick: float) -> str:
        """Return why an answer may not belong to the present request; empty if the servo's clock shows that it does.

        The first answer of a servo starts the estimate of its clock. A jump of the clock shows that the servo has
        restarted, and starts the estimate again. Neither the first answer nor the answer with the jump counts as fresh.
        """
        clock = self._clocks.get(servo)
        if clock is None or abs(tick_clock.jump(clock, tick, received)) >= tick_clock.RESTART:
            self._clocks[servo] = tick_clock.begin(tick, received)
            self._suspects.add(servo)
            return f"has restarted, or answers at least {tick_clock.RESTART * 1e3:.0f} ms late"
        self._clocks[servo] = clock = tick_clock.update(clock, tick, received)
        age = tick_clock.age(clock, tick, requested_at)
        if age > tick_clock.RESOLUTION:
            self._bus.count_stale(servo, received - requested_at + age)
            return self._bus.why_no_answer(servo)
        return ""

    def _note_alerts(self, replies: Mapping[int, Reply]) -> None:
        for servo, reply in replies.items():
            if reply.alert:
                self._alerts.add(servo)
                self._suspects.add(servo)
            else:
                self._alerts.discard(servo)

    def _read_health(self) -> None:
        register = _HEALTH[self._turn]
        self._turn = (self._turn + 1) % len(_HEALTH)
        suspicious = {"torque_enable": (0,), "bus_watchdog": (0, WATCHDOG_EXPIRED)}
        _, replies = self._bus.sync_read(register.address, register.size, self._ids)
        self._note_alerts(replies)
        for servo, reply in replies.items():
            if reply.error:
                continue
            value = register.unpack_from(reply.data, register.address)
            if value in suspicious.get(register.name, (value,) if value else ()):
                self._suspects.add(servo)
