# SPDX-License-Identifier: Apache-2.0
"""One virtual servo: instructions on its registers, its shaft, its protections.

Times are seconds of the virtual robot's clock and never go back. What the e-manual leaves open is
decided here as follows: the Bus Watchdog is fed only by packets that name this servo or that are
broadcast writes; after it fired the shaft holds where it stopped until a new goal is written;
torque cannot be enabled after a shutdown (Result Fail), nor a factory reset be done with torque on.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from random import Random

from worm_driver.virtual_robot import motor
from worm_driver.virtual_robot.control_table import (
    CURRENT_MODE,
    CURRENT_POSITION_MODE,
    PULSES_PER_TURN,
    PWM_MODE,
    VELOCITY_MODE,
    Register,
    ServoModel,
)
from worm_driver.virtual_robot.memory import RegisterError, RegisterMemory
from worm_driver.virtual_robot.motor import PULSES_PER_RADIAN, MotorCommand, MotorState
from worm_driver.virtual_robot.packet import ALERT, Error

INPUT_VOLTAGE_ERROR = 1 << 0
OVERHEATING_ERROR = 1 << 2
OVERLOAD_ERROR = 1 << 5

_SPEED_UNIT = 0.229 / 60 * PULSES_PER_TURN  # pulses/s
_ACCELERATION_UNIT = 214.577 / 3600 * PULSES_PER_TURN  # pulses/s^2
_WATCHDOG_UNIT = 0.020  # s
_FULL_PWM = 885
_TICK_WRAP = 32768  # ms
_IN_POSITION = 20  # pulses
_BLOCKED_ERROR = 0.2  # rad of following error at which a blocked motor takes its full current
_OVERLOAD_LEVEL = 0.9  # of the current limit or the stall torque
_OVERLOAD_TIME = 1.0  # s
_CLEAR_KEY = b"\x01\x44\x58\x4c\x22"
_FACTORY_RESET_KEEPS: Mapping[int, tuple[str, ...]] = {
    0xFF: (),
    0x01: ("id",),
    0x02: ("id", "baud_rate"),
}


@dataclass
class Surroundings:
    """What acts on a servo from outside, set by its owner before a step.

    load: N*m on the shaft, positive when it turns it backward. voltage: V. ambient: degC.
    blocked: the shaft cannot turn.
    """

    load: float = 0.0
    voltage: float = 12.0
    ambient: float = 25.0
    blocked: bool = False


@dataclass
class Servo:
    """State of one servo. settings: EEPROM values, raw; start: pulses of the shaft, unfolded."""

    model: ServoModel
    settings: Mapping[str, int]
    start: float
    boot_time: float
    random: Random
    surroundings: Surroundings = field(default_factory=Surroundings)

    def __post_init__(self) -> None:
        self.memory = RegisterMemory(self.model, self.settings)
        self.motor: MotorState = motor.at_rest(self.start)
        self._time = 0.0
        self._silent_until = 0.0
        self._heat = 0.0  # degC above the ambient temperature
        self._power_up()

    # --- life ---------------------------------------------------------------------------------

    def reboot(self, time: float) -> None:
        """Power-up or Reboot: RAM is lost, torque is off, the position is folded to one turn."""
        self._silent_until = time + self.boot_time
        self._time = time
        self._power_up()

    def _power_up(self) -> None:
        self.memory.power_up()
        self.motor = motor.at_rest(self.motor.position)
        self._boot_moment = self._time
        self._shut_down = False
        self._overload_since = math.inf
        self._fed_at = self._time
        self._registered: tuple[int, bytes] | None = None
        self._fold()
        self.memory["goal_position"] = self._raw_position(self.motor.position)
        self._update_command()

    def answers(self, time: float) -> bool:
        """Whether the servo listens (it does not while it boots)."""
        return time >= self._silent_until

    @property
    def servo_id(self) -> int:
        """Its id on the bus."""
        return self.memory["id"]

    @property
    def shaft_angle(self) -> float:
        """rad, unfolded."""
        return self.motor.position / PULSES_PER_RADIAN

    @property
    def return_delay(self) -> float:
        """S between an instruction and its status."""
        return self.memory["return_delay_time"] * 2e-6

    def alert(self) -> int:
        """The alert bit of the error byte."""
        return ALERT if self.memory["hardware_error_status"] else 0

    def feed_watchdog(self, time: float) -> None:
        """An instruction packet for this servo was seen."""
        self._fed_at = time

    # --- instructions -------------------------------------------------------------------------

    def read(self, address: int, length: int) -> bytes:
        """Register bytes, the measured ones fresh. Raises RegisterError."""
        self._refresh()
        return self.memory.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Sets registers, all or none. Raises RegisterError."""
        changes = self.memory.check_write(address, data)
        turns_on = any(row.name == "torque_enable" and value for row, value in changes)
        if turns_on and self._shut_down:
            raise RegisterError(Error.RESULT_FAIL)
        for row, value in changes:
            self._apply(row, value)
        self._update_command()

    def register_write(self, address: int, data: bytes) -> None:
        """Keeps a write for action(). Raises RegisterError."""
        self.memory.check_write(address, data)
        self._registered = (address, data)
        self.memory["registered_instruction"] = 1

    def action(self) -> None:
        """Does the registered write. Raises RegisterError."""
        if self._registered is None:
            raise RegisterError(Error.INSTRUCTION)
        (address, data), self._registered = self._registered, None
        self.memory["registered_instruction"] = 0
        self.write(address, data)

    def clear_turns(self, parameters: bytes) -> None:
        """The Clear instruction: folds the position to one turn. Raises RegisterError."""
        if parameters != _CLEAR_KEY:
            raise RegisterError(Error.DATA_RANGE)
        if self.memory["firmware_version"] < 42:
            raise RegisterError(Error.INSTRUCTION)
        self._refresh()
        if self.memory["moving"]:
            raise RegisterError(Error.RESULT_FAIL)
        self._fold()
        self.memory["goal_position"] = self._raw_position(self.motor.position)
        self._update_command()

    def factory_reset(self, parameters: bytes, time: float) -> None:
        """The Factory Reset instruction, then a reboot. Raises RegisterError."""
        if len(parameters) != 1 or parameters[0] not in _FACTORY_RESET_KEEPS:
            raise RegisterError(Error.DATA_RANGE)
        if self.memory["torque_enable"]:
            raise RegisterError(Error.RESULT_FAIL)
        self.memory.set_to_factory(_FACTORY_RESET_KEEPS[parameters[0]])
        self.reboot(time)

    def _apply(self, row: Register, value: int) -> None:
        self.memory[row.name] = value
        match row.name:
            case "operating_mode":
                self.memory.reset_mode_dependents()
                if value == 3:
                    self._fold()
            case "torque_enable":
                self._set_torque_side_effects(value)
            case "bus_watchdog":
                self._fed_at = self._time
            case "goal_position" | "goal_velocity" | "goal_current" | "goal_pwm":
                self._take_goal(row.name)

    def _set_torque_side_effects(self, value: int) -> None:
        self._fed_at = self._time
        if not value:
            return
        if self.memory["operating_mode"] == 3:
            self._fold()
        self.motor = motor.at_rest(self.motor.position)
        self.memory["goal_position"] = self._raw_position(self.motor.position)
        self._goal = self.motor.position

    def _take_goal(self, name: str) -> None:
        wakes = self.memory["drive_mode"] & 0x08 and not self._shut_down
        if wakes and not self.memory["torque_enable"]:
            goal = self.memory[name]
            self.memory["torque_enable"] = 1
            self._set_torque_side_effects(1)
            self.memory[name] = goal
        if name == "goal_position":
            self._goal = self._shaft_position(self.memory["goal_position"])

    # --- position as the registers count it -------------------------------------------------------

    def _direction(self) -> int:
        return -1 if self.memory["drive_mode"] & 0x01 else 1

    def _raw_position(self, shaft: float) -> int:
        counted = math.floor(self._direction() * shaft) - self._folded_turns * PULSES_PER_TURN
        return counted + self.memory["homing_offset"]

    def _shaft_position(self, raw: int) -> float:
        counted = raw - self.memory["homing_offset"] + self._folded_turns * PULSES_PER_TURN
        return self._direction() * (counted + 0.5)

    def _fold(self) -> None:
        counted = math.floor(self._direction() * self.motor.position)
        self._folded_turns = counted // PULSES_PER_TURN
        self._goal = self.motor.position

    # --- motion -------------------------------------------------------------------------------

    def step(self, time: float, step_s: float) -> None:
        """Moves the shaft to a time, a step (s) after the last one."""
        self._time = time
        if self._watchdog_fires(time):
            self._stop_by_watchdog()
        command = self._command
        if self.surroundings.blocked:
            command = command._replace(kind=motor.BLOCKED)
        self.motor = motor.step(self.motor, command, self.surroundings.load, self.model, step_s)

    def _watchdog_fires(self, time: float) -> bool:
        return time - self._fed_at > self._watchdog_time

    def _stop_by_watchdog(self) -> None:
        self.memory["bus_watchdog"] = -1
        self.memory["profile_velocity"] = 0
        self.memory["profile_acceleration"] = 0
        self.memory["goal_velocity"] = 0
        self.motor = motor.at_rest(self.motor.position)
        self._goal = self.motor.position
        self._update_command()

    def _update_command(self) -> None:
        """Puts what the registers ask for into numbers, so that a step needs no register."""
        memory = self.memory
        watchdog = memory["bus_watchdog"]
        armed = watchdog > 0 and memory["torque_enable"]
        self._watchdog_time = watchdog * _WATCHDOG_UNIT if armed else math.inf
        kind, goal, pwm = motor.POSITION, self._goal, abs(memory["goal_pwm"])
        match memory["operating_mode"]:
            case mode if mode == VELOCITY_MODE:
                kind = motor.VELOCITY
                goal = self._direction() * memory["goal_velocity"] * _SPEED_UNIT
            case mode if mode == PWM_MODE:
                kind = motor.VELOCITY
                goal = self._direction() * memory["goal_pwm"] / _FULL_PWM * self._full_speed()
            case mode if mode == CURRENT_MODE:
                kind = motor.VELOCITY
                sign = self._direction() * (memory["goal_current"] > 0)
                goal = sign * self._full_speed()
        if not memory["torque_enable"]:
            kind = motor.LIMP
        acceleration, velocity = self._profile_limits(goal)
        self._command = MotorCommand(
            kind,
            goal,
            acceleration,
            velocity,
            self._full_speed() * pwm / _FULL_PWM,
            self._torque_limit(),
        )

    def _full_speed(self) -> float:
        """pulses/s that the motor reaches at the supply's voltage."""
        share = self.surroundings.voltage / self.model.nominal_voltage
        return self.model.no_load_speed * share * PULSES_PER_RADIAN

    def _torque_limit(self) -> float:
        if self.memory["operating_mode"] not in (CURRENT_MODE, CURRENT_POSITION_MODE):
            return math.inf
        goal = abs(self.memory["goal_current"]) * self.model.current_unit
        return goal * self.model.torque_constant

    def _profile_limits(self, goal: float) -> tuple[float, float]:
        """Acceleration (pulses/s^2) and velocity (pulses/s) of the profile; 0 means none."""
        velocity, acceleration = (
            self.memory["profile_velocity"],
            self.memory["profile_acceleration"],
        )
        if self.memory["drive_mode"] & 0x04:  # time-based: both in ms
            duration, ramp = velocity * 1e-3, min(acceleration, velocity / 2) * 1e-3
            distance = abs(goal - self.motor.trajectory_position)
            speed = distance / (duration - ramp) if duration > 0 else math.inf
            return (speed / ramp if ramp > 0 else math.inf), speed
        return (
            acceleration * _ACCELERATION_UNIT or math.inf,
            velocity * _SPEED_UNIT or math.inf,
        )

    # --- measurements and protections -------------------------------------------------------------

    def supervise(self, duration: float) -> None:
        """Temperature and protections over a duration (s); to be called some ten times a second."""
        current = self._motor_torque() / self.model.torque_constant
        heating = 20.0 * (current / self.model.stall_current) ** 2 + 5.0
        self._heat += (heating - self._heat) * min(duration / 300.0, 1.0)
        found = 0
        voltage = self._voltage_raw()
        if not self.memory["min_voltage_limit"] <= voltage <= self.memory["max_voltage_limit"]:
            found |= INPUT_VOLTAGE_ERROR
        if self._temperature() > self.memory["temperature_limit"]:
            found |= OVERHEATING_ERROR
        if self._is_overloaded():
            found |= OVERLOAD_ERROR
        if found:
            self.raise_alert(found)

    def raise_alert(self, bits: int) -> None:
        """Sets bits of Hardware Error Status, and shuts down if the Shutdown mask says so."""
        self.memory["hardware_error_status"] |= bits
        if bits & self.memory["shutdown"]:
            self.memory["torque_enable"] = 0
            self._shut_down = True
            self._update_command()

    def _is_overloaded(self) -> bool:
        if abs(self._motor_torque()) < _OVERLOAD_LEVEL * self._strongest():
            self._overload_since = math.inf
            return False
        self._overload_since = min(self._overload_since, self._time)
        return self._time - self._overload_since >= _OVERLOAD_TIME

    def _strongest(self) -> float:
        """N*m that the motor gives at most."""
        if "current_limit" not in self.memory:
            return self.model.stall_torque
        limit = self.memory["current_limit"] * self.model.current_unit
        return min(limit * self.model.torque_constant, self.model.stall_torque)

    def _motor_torque(self) -> float:
        """N*m, positive when the motor pushes forward."""
        if not self.memory["torque_enable"]:
            return 0.0
        if not self.surroundings.blocked:
            return self.surroundings.load
        error = (self._command.goal - self.motor.position) / PULSES_PER_RADIAN
        if self._command.kind == motor.VELOCITY:
            error = math.copysign(_BLOCKED_ERROR, self._command.goal) if self._command.goal else 0.0
        share = min(max(error / _BLOCKED_ERROR, -1.0), 1.0)
        return share * self._strongest()

    def _temperature(self) -> int:
        return round(self.surroundings.ambient + self._heat)

    def _voltage_raw(self) -> int:
        return max(round(self.surroundings.voltage * 10), 0)

    def _refresh(self) -> None:
        """Puts the measured values into their registers."""
        memory, sign = self.memory, self._direction()
        velocity = sign * round(self.motor.velocity / _SPEED_UNIT)
        moving = abs(velocity) > memory["moving_threshold"]
        torque = sign * self._motor_torque()
        memory["realtime_tick"] = int((self._time - self._boot_moment) * 1000) % _TICK_WRAP
        memory["moving"] = int(moving)
        memory["moving_status"] = self._moving_status()
        memory["present_velocity"] = velocity
        memory["present_position"] = self._raw_position(self.motor.position)
        memory["velocity_trajectory"] = sign * round(self.motor.trajectory_velocity / _SPEED_UNIT)
        memory["position_trajectory"] = self._raw_position(self.motor.trajectory_position)
        memory["present_input_voltage"] = self._voltage_raw()
        memory["present_temperature"] = min(self._temperature(), 255)
        share = torque / self.model.stall_torque
        memory["present_pwm"] = round(min(max(share, -1.0), 1.0) * _FULL_PWM)
        noise = self.random.gauss(0.0, 1.0) if memory["torque_enable"] else 0.0
        if "present_current" in memory:
            current = torque / self.model.torque_constant / self.model.current_unit
            memory["present_current"] = round(min(max(current + noise, -32767), 32767))
        else:
            memory["present_load"] = round(min(max(share * 1000 + noise, -1000), 1000))

    def _moving_status(self) -> int:
        if self._command.kind != motor.POSITION:
            return 0
        arrived = abs(self._goal - self.motor.position) <= _IN_POSITION
        ongoing = self.motor.trajectory_position != self._goal
        profile = 0x30 if self._command.velocity != math.inf else 0
        return int(arrived) | int(ongoing) << 1 | profile
