# SPDX-License-Identifier: Apache-2.0
"""Virtual servo: power cycle, instructions and shaft.

Times are seconds of the virtual robot's clock and do not decrease. Where the e-manual is silent, the servo behaves as
follows. Only an intact packet resets the Bus Watchdog. A group read or write resets it for the servos in its list; any
other packet for the servo with its id, or for all servos with the broadcast id. After the watchdog has fired, the shaft
holds its position in all modes until 0 is written to the watchdog's register. The servo answers with the error Result
Fail to a write that turns the torque on after a shutdown.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from random import Random

from worm_driver.virtual_robot.servo import drive, motor
from worm_driver.virtual_robot.servo.control_table import (
    GOALS,
    POSITION_MODE,
    Register,
    VirtualServoModel,
)
from worm_driver.virtual_robot.servo.drive import (
    TORQUE_ON_BY_GOAL,
    Encoder,
    Surroundings,
    direction_of,
    motor_command,
    turns_of,
)
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN, MotorState, Yield
from worm_driver.virtual_robot.servo.register_memory import RegisterError, RegisterMemory
from worm_driver.virtual_robot.wire.packet import ALERT, Error

_WATCHDOG_UNIT = 0.020  # s per raw unit of bus_watchdog
_TICK_WRAP = 32768  # ms, period of Realtime Tick


@dataclass
class Servo:
    """Servo with registers, motor and protections.

    Attributes:
        settings: raw EEPROM values that differ from the factory values.
        start: shaft position at time 0, pulses, unfolded (see `drive.Encoder`).
        boot_time: time for which the servo does not answer after a reboot, s.
    """

    model: VirtualServoModel
    settings: Mapping[str, int]
    start: float
    boot_time: float
    random: Random
    surroundings: Surroundings = field(default_factory=Surroundings)

    def __post_init__(self) -> None:
        self.memory = RegisterMemory(self.model, self.settings)
        self.motor: MotorState = motor.at_rest(self.start)
        self._yield = Yield()
        self._time = 0.0
        self._silent_until = 0.0
        self._power_up()

    # --- life ---------------------------------------------------------------------------------

    def reboot(self, time: float) -> None:
        """Boot, after a reboot or at power-up: RAM is reset, torque is off, the position is folded to one turn."""
        self._silent_until = time + self.boot_time
        self._time = time
        self._power_up()

    def _power_up(self) -> None:
        self.memory.power_up()
        self._booted_at = self._time
        self._shut_down = False
        self._overload = 0.0  # s, duration of the present overload
        self._fed_at = self._time
        self._fold()
        self._hold()

    def answers(self, time: float) -> bool:
        """Return False while the servo boots and therefore does not answer, else True."""
        return time >= self._silent_until

    @property
    def servo_id(self) -> int:
        """Id of the servo on the bus."""
        return self.memory["id"]

    @property
    def motor_angle(self) -> float:
        """Shaft angle without the yield, rad, unfolded.

        The body follows this angle: its gain and its time constant, which relate its length to the command, contain
        the yield of the servo.
        """
        return self.motor.position / PULSES_PER_RADIAN

    @property
    def shaft(self) -> MotorState:
        """Motion of the loaded shaft, which the encoder measures."""
        position, velocity = self.motor.position, self.motor.velocity
        return self.motor._replace(
            position=position - self._yield.distance, velocity=velocity - self._yield.rate
        )

    @property
    def return_delay(self) -> float:
        """Delay between an instruction and its status packet, s."""
        return self.memory["return_delay_time"] * 2e-6

    def alert(self) -> int:
        """Return the alert bit of the error byte."""
        return ALERT if self.memory["hardware_error_status"] else 0

    def feed_watchdog(self, time: float) -> None:
        """Reset the Bus Watchdog's timer."""
        self._fed_at = time

    # --- instructions -------------------------------------------------------------------------

    def read(self, address: int, length: int) -> bytes:
        """Return register bytes with updated measurements. Raises RegisterError."""
        self._measure()
        return self.memory.read(address, length)

    def write(self, address: int, data: bytes) -> None:
        """Set registers, all or none. Raises RegisterError."""
        changes = self.memory.check_write(address, data)
        turns_on = any(row.name == "torque_enable" and value for row, value in changes)
        if turns_on and self._shut_down:
            raise RegisterError(Error.RESULT_FAIL)
        for row, value in changes:
            self._apply(row, value)
        self._update_command()

    def _apply(self, row: Register, value: int) -> None:
        """Set one register and apply its side effects."""
        self._wake_by_goal(row.name)
        self.memory[row.name] = value
        if row.name == "operating_mode":
            self.memory.reset_mode_dependents()
            self._fold_in_position_mode()
        elif row.name == "torque_enable":
            self._switch_torque(value)
        elif row.name == "bus_watchdog":
            self._fed_at = self._time
        elif row.name == "goal_position":
            self._goal = self._encoder.shaft(value)

    def _switch_torque(self, value: int) -> None:
        self._fed_at = self._time
        if value:
            self._fold_in_position_mode()
            self._hold()

    def _wake_by_goal(self, name: str) -> None:
        """Turn torque on if the drive mode has Torque On by Goal Update."""
        asleep = not self.memory["torque_enable"] and not self._shut_down
        if name in GOALS and asleep and self.memory["drive_mode"] & TORQUE_ON_BY_GOAL:
            self.memory["torque_enable"] = 1
            self._switch_torque(1)

    # --- position -----------------------------------------------------------------------------

    @property
    def _encoder(self) -> Encoder:
        return Encoder(direction_of(self.memory), self._folded_turns, self.memory["homing_offset"])

    def _fold(self) -> None:
        """Remove the whole turns from Present Position."""
        self._folded_turns = turns_of(self.shaft.position, direction_of(self.memory))

    def _fold_in_position_mode(self) -> None:
        if self.memory["operating_mode"] == POSITION_MODE:
            self._fold()

    def _hold(self) -> None:
        """Set the goal to the shaft's position."""
        self.motor = motor.at_rest(self.motor.position)
        self._goal = self.motor.position
        self.memory["goal_position"] = self._encoder.raw(self._goal)
        self._update_command()

    # --- motion -------------------------------------------------------------------------------

    def step(self, time: float, step_s: float) -> None:
        """Advance the shaft to a time, one step (s) after the last one."""
        self._time = time
        if time - self._fed_at > self._watchdog_time:
            self._stop_by_watchdog()
        around = self.surroundings
        command = self._command
        if around.blocked:
            command = command._replace(kind=motor.BLOCKED)
        if command.kind == motor.LIMP and self._yield.distance:
            self.motor, self._yield = self.shaft, Yield()
        self.motor = motor.step(self.motor, command, around.load, self.model, step_s)
        if around.load or self._yield.distance:
            self._yield = motor.step_yield(self._yield, command, around.load, step_s)

    def _stop_by_watchdog(self) -> None:
        for name in ("profile_velocity", "profile_acceleration", "goal_velocity"):
            self.memory[name] = 0
        self.memory["bus_watchdog"] = -1
        goal = self.memory["goal_position"]
        self._hold()
        self.memory["goal_position"] = goal  # The watchdog does not change this register.

    def _update_command(self) -> None:
        """Compute the motor command from the registers, so that a step need not decode them."""
        watchdog = self.memory["bus_watchdog"]
        armed = watchdog > 0 and self.memory["torque_enable"]
        self._watchdog_time = watchdog * _WATCHDOG_UNIT if armed else math.inf
        voltage = self.surroundings.voltage
        self._command = motor_command(self.memory, self.model, voltage, self._goal)

    # --- measurements and protections ---------------------------------------------------------

    def supervise(self, duration: float) -> None:
        """Update the protections for the duration (s) since the last call."""
        overloaded = drive.is_overloaded(self._torque(), self.memory, self.model)
        self._overload = self._overload + duration if overloaded else 0.0
        bits = drive.alerts(self.memory, self.surroundings, self._overload)
        if bits:
            self.raise_alert(bits)

    def raise_alert(self, bits: int) -> None:
        """Set bits of Hardware Error Status, and shut down if the Shutdown mask contains them."""
        self.memory["hardware_error_status"] |= bits
        if bits & self.memory["shutdown"]:
            self.memory["torque_enable"] = 0
            self._shut_down = True
            self._update_command()

    def _torque(self) -> float:
        position = self.motor.position
        return drive.motor_torque(
            self._command, position, self.surroundings, self.memory, self.model
        )

    def _measure(self) -> None:
        """Write the measured values into their registers."""
        memory, around = self.memory, self.surroundings
        noise = self.random.gauss(0.0, 1.0) if memory["torque_enable"] else 0.0
        registers = {
            **drive.motion_registers(self._encoder, self.shaft),
            **drive.torque_register(memory, self.model, self._torque(), noise),
            "realtime_tick": int((self._time - self._booted_at) * 1000) % _TICK_WRAP,
            "present_input_voltage": around.voltage_raw,
            "present_temperature": min(round(around.temperature), 255),
        }
        for name, value in registers.items():
            memory[name] = value
