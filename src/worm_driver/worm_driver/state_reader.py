# SPDX-License-Identifier: Apache-2.0
"""Reads the state of all servos once per cycle, and makes sure that it is of this cycle."""

from collections.abc import Callable, Mapping, Sequence

from worm_driver import tick_clock
from worm_driver.encoding import unpack_from
from worm_driver.registers import COMMON, WATCHDOG_EXPIRED
from worm_driver.servo_bus import Reply, ServoBus
from worm_driver.servos import Servo
from worm_driver.telemetry import SILENT, STATE_SIZE, STATE_START, ServoState, decode
from worm_driver.tick_clock import TickClock

#: s, an answer whose clock is further ahead of its question comes from a servo that has restarted
_CLOCK_JUMP = 0.1

#: one of these registers is read per cycle beside the state, in turn: none of them lies in the state's block
_HEALTH = tuple(COMMON[name] for name in ("torque_enable", "hardware_error_status", "bus_watchdog"))


class StateReader:
    """Reads states, with one repetition when a servo was silent, garbled or late.

    Args:
        bus: where the servos are.
        servos: in the order in which their states are wanted.
        clock: s, monotonic.
    """

    def __init__(self, bus: ServoBus, servos: Sequence[Servo], clock: Callable[[], float]):
        self._bus = bus
        self._servos = tuple(servos)
        self._ids = [servo.number for servo in servos]
        self._clock = clock
        self._clocks: dict[int, TickClock] = {}
        self._restarted: set[int] = set()
        self._alerts: set[int] = set()
        self._health: dict[str, dict[int, int]] = {register.name: {} for register in _HEALTH}
        self._turn = 0
        bus.drain()

    def read(self) -> tuple[float, tuple[ServoState, ...]]:
        """When the servos were asked (s, monotonic), and their states; SILENT without a fresh answer.

        Raises:
            PortError: the port is gone.
        """
        asked, states = self._ask(self._fresh)
        if len(states) < len(self._ids):
            self._bus.drain()
            asked, states = self._ask(self._fresh_on_a_quiet_line)
        if len(states) == len(self._ids):
            self._read_health()
        return asked, tuple(states.get(number, SILENT) for number in self._ids)

    def suspects(self) -> frozenset[int]:
        """Servos whose torque should be on, and that gave a sign of a fault or a restart since the last call.

        A sign is not yet a fault: a late answer can look like one.
        """
        odd = self._restarted | self._alerts
        odd |= {servo for servo, torque in self._health["torque_enable"].items() if not torque}
        odd |= {servo for servo, error in self._health["hardware_error_status"].items() if error}
        odd |= {
            s for s, left in self._health["bus_watchdog"].items() if left in (0, WATCHDOG_EXPIRED)
        }
        self.forget()
        return frozenset(odd)

    def forget(self) -> None:
        """Drops the signs collected so far, except for alerts, which last until an answer without one."""
        self._restarted.clear()
        for values in self._health.values():
            values.clear()

    @property
    def alerts(self) -> frozenset[int]:
        """Servos whose last answer said that they have a hardware error."""
        return frozenset(self._alerts)

    def _ask(
        self, accept: Callable[[int, float, ServoState], bool]
    ) -> tuple[float, Mapping[int, ServoState]]:
        asked = self._clock()
        replies = self._bus.sync_read(STATE_START, STATE_SIZE, self._ids)
        self._note_alerts(replies)
        states = {}
        for servo in self._servos:
            reply = replies.get(servo.number)
            if reply is None or reply.error:
                continue
            state = decode(servo.model, reply.data)
            if accept(servo.number, asked, state):
                states[servo.number] = state
        return asked, states

    def _fresh(self, servo: int, asked: float, state: ServoState) -> bool:
        """Accepts an answer that the servo's clock shows to be one to this question."""
        clock = self._clocks.get(servo)
        if clock is None:
            self._clocks[servo] = tick_clock.begin(asked, state.tick)
            return True
        lag = tick_clock.lag(clock, asked, state.tick)
        if not -_CLOCK_JUMP <= lag <= tick_clock.TOLERANCE:
            self._bus.count_stale()
            return False
        self._clocks[servo] = tick_clock.update(clock, asked, state.tick)
        return True

    def _fresh_on_a_quiet_line(self, servo: int, asked: float, state: ServoState) -> bool:
        """As _fresh; but as nothing late can be on the line, a wrong clock means that the servo restarted."""
        if not self._fresh(servo, asked, state):
            self._restarted.add(servo)
            self._clocks[servo] = tick_clock.begin(asked, state.tick)
        return True

    def _note_alerts(self, replies: Mapping[int, Reply]) -> None:
        for servo, reply in replies.items():
            (self._alerts.add if reply.alert else self._alerts.discard)(servo)

    def _read_health(self) -> None:
        register = _HEALTH[self._turn]
        self._turn = (self._turn + 1) % len(_HEALTH)
        replies = self._bus.sync_read(register.address, register.size, self._ids)
        self._note_alerts(replies)
        for servo, reply in replies.items():
            if not reply.error:
                value = unpack_from(register, reply.data, register.address)
                self._health[register.name][servo] = value
