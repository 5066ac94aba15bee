# SPDX-License-Identifier: Apache-2.0
"""Reads the state of all servos once per cycle, and makes sure that it is of this cycle."""

from collections.abc import Mapping, Sequence

from worm_driver.control.telemetry import SILENT, STATE_SIZE, STATE_START, ServoState, decode
from worm_driver.servos import tick_clock
from worm_driver.servos.bus_types import Reply, error_text
from worm_driver.servos.encoding import from_raw, unpack_from
from worm_driver.servos.registers import COMMON, WATCHDOG_EXPIRED
from worm_driver.servos.servo_bus import SILENCE_REMEDY, ServoBus
from worm_driver.servos.servo_setup import Servo
from worm_driver.servos.tick_clock import TickClock

#: one of these registers is read per cycle beside the state, in turn: none of them lies in the state's block
_HEALTH = tuple(COMMON[name] for name in ("torque_enable", "hardware_error_status", "bus_watchdog"))

#: the block that holds all of a servo's health, and its clock
_HEALTH_START, _HEALTH_END = COMMON["torque_enable"].address, COMMON["realtime_tick"].end
#: exchanges from which a servo's clock is learnt
_FIRST_ANSWERS = 3


class StateReader:
    """Reads states, with one repetition when a servo was silent, garbled or late.

    Attributes:
        problems: why a servo's state is SILENT, in words, by id.

    Raises:
        BusError: the port is gone.
    """

    def __init__(self, bus: ServoBus, servos: Sequence[Servo]):
        self._bus = bus
        self._servos = tuple(servos)
        self._ids = [servo.number for servo in servos]
        self._clocks: dict[int, TickClock] = {}
        self._suspects: set[int] = set()
        self._alerts: set[int] = set()
        self._turn = 0
        self.problems: dict[int, str] = {}
        self.learn_clocks()

    def read(self) -> tuple[float, tuple[ServoState, ...]]:
        """When the servos were asked (s, monotonic), and their states; SILENT without a fresh answer.

        Raises BusError: the port is gone.
        """
        asked, states = self._ask()
        if len(states) < len(self._ids):
            self._bus.unsettle()
            asked, states = self._ask()
        if len(states) == len(self._ids):
            self._read_health()
        return asked, tuple(states.get(number, SILENT) for number in self._ids)

    def take_suspect(self) -> int | None:
        """A servo that has given a sign of a fault or a restart, for a closer look; None when there is none.

        A sign is not yet a fault: a late answer can look like one.
        """
        return self._suspects.pop() if self._suspects else None

    def forget_suspects(self) -> None:
        """Drops the signs collected so far."""
        self._suspects.clear()

    @property
    def alerts(self) -> frozenset[int]:
        """Servos whose last answer said that they have a hardware error."""
        return frozenset(self._alerts)

    def learn_clocks(self) -> None:
        """Learns the servos' clocks anew, from questions that each wait until no older answer can come.

        Raises BusError: the port is gone.
        """
        self._clocks.clear()
        with self._bus.patient():
            for _ in range(_FIRST_ANSWERS):
                self._bus.unsettle()
                self._ask()
        self.forget_suspects()

    def look(self, servo: Servo, names: Sequence[str]) -> Mapping[str, int] | None:
        """Registers of a servo's health by name, asked now on a quiet line; None without a fresh answer.

        All in one block with the servo's clock, so that a late answer is never taken for a fault. Raises BusError: the
        port is gone.
        """
        self._bus.unsettle()
        size = _HEALTH_END - _HEALTH_START
        asked, replies = self._bus.sync_read(_HEALTH_START, size, [servo.number])
        reply = replies.get(servo.number)
        if reply is None or reply.error:
            return None
        values = {
            name: unpack_from(servo[name], reply.data, _HEALTH_START)
            for name in ("realtime_tick", *names)
        }
        tick = from_raw(servo["realtime_tick"], values["realtime_tick"])
        return values if self._is_fresh(servo.number, asked, reply.received, tick) else None

    def _ask(self) -> tuple[float, Mapping[int, ServoState]]:
        asked, replies = self._bus.sync_read(STATE_START, STATE_SIZE, self._ids)
        self._note_alerts(replies)
        states = {}
        self.problems.clear()
        for servo in self._servos:
            reply = replies.get(servo.number)
            if reply is None:
                self.problems[servo.number] = f"does not answer intact: {SILENCE_REMEDY}"
            elif reply.error:
                self.problems[servo.number] = error_text(reply.error)
            else:
                state = decode(servo.model, reply.data)
                if self._is_fresh(servo.number, asked, reply.received, state.tick):
                    states[servo.number] = state
                else:
                    self.problems[servo.number] = "answers late"
        return asked, states

    def _is_fresh(self, servo: int, asked: float, received: float, tick: float) -> bool:
        """Whether the servo's clock shows an answer to be one to this question.

        A clock that jumped belongs to a servo that has restarted; its answer counts from the next time on.
        """
        clock = self._clocks.get(servo)
        if clock is None or abs(tick_clock.jump(clock, tick, received)) >= tick_clock.RESTART:
            self._clocks[servo] = tick_clock.begin(tick, received)
            self._suspects.add(servo)
            return False
        self._clocks[servo] = clock = tick_clock.update(clock, tick, received)
        if tick_clock.age(clock, tick, asked) > tick_clock.RESOLUTION:
            self._bus.note_stale()
            return False
        return True

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
        odd = {"torque_enable": (0,), "bus_watchdog": (0, WATCHDOG_EXPIRED)}
        _, replies = self._bus.sync_read(register.address, register.size, self._ids)
        self._note_alerts(replies)
        for servo, reply in replies.items():
            if reply.error:
                continue
            value = unpack_from(register, reply.data, register.address)
            if value in odd.get(register.name, (value,) if value else ()):
                self._suspects.add(servo)
