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
from dataclasses import dataclass
from random import Random

from worm_driver.servos.registers import POSITION_MODE, VELOCITY_MODE
from worm_driver.virtual_robot.servo import motor
from worm_driver.virtual_robot.servo.control_table import (
    PULSES_PER_TURN,
    PWM_MODE,
    VirtualRegister,
    VirtualServoModel,
)
from worm_driver.virtual_robot.servo.motor import (
    PULSES_PER_RADIAN,
    MotorCommand,
    MotorState,
    Yield,
)
from worm_driver.virtual_robot.servo.register_memory import RegisterError, RegisterMemory
from worm_driver.virtual_robot.wire.packet import ALERT, Error
from worm_msgs.servo_models import RPM

REVERSE_DRIVE = 0x01

INPUT_VOLTAGE_ERROR = 1 << 0
OVERHEATING_ERROR = 1 << 2
OVERLOAD_ERROR = 1 << 5

SPEED_UNIT = 0.229 / 60 * PULSES_PER_TURN  # pulses/s per raw unit of a velocity register
FULL_PWM = 885  # raw value of a PWM register at full output
#: PWM units per pulse of position error, per raw unit of position_p_gain (e-manual)
_GAIN_UNIT = 1 / 128
# pulses/s^2 per raw unit of profile_acceleration
_ACCELERATION_UNIT = 214.577 / 3600 * PULSES_PER_TURN

_BLOCKED_ERROR = 0.2  # rad; following error at which a blocked motor reaches its strongest torque
_OVERLOAD_LEVEL = 0.9  # torque above which a servo is overloaded, relative to its strongest torque
_OVERLOAD_TIME = 1.0  # s; duration of an overload after which the servo reports it
_HEAT = 5.0  # degC; temperature of a servo above ambient
_WATCHDOG_UNIT = 0.020  # s per raw unit of bus_watchdog
_TICK_WRAP = 32768  # ms, period of Realtime Tick


@dataclass(frozen=True)
class Encoder:
    """Conversion between shaft position and position registers: reverse mode, folding, homing offset.

    Folding removes the whole turns from the position registers, for example when the servo boots. The shaft position
    continues to count all turns (unfolded).

    Attributes:
        direction: direction in which the registers count: 1, or -1 in reverse mode (drive_mode).
        folded_turns: number of turns that folding has removed.
        homing_offset: value of the register homing_offset, pulses.
    """

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """Return the register value for a shaft position (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """Return the centre of the range of shaft positions (pulses, unfolded) that have a register value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


class Servo:
    """Servo with registers, motor and protections.

    Attributes:
        model: servo model.
        memory: registers.
        motor: motion of the shaft without load.
        load: torque on the shaft, N*m; positive when it turns the shaft backward.
        voltage: supply voltage, V.
        ambient: ambient temperature, degC.
        blocked: True if the shaft cannot turn.
    """

    def __init__(
        self,
        model: VirtualServoModel,
        settings: Mapping[str, int],
        start: float,
        boot_time: float,
        random: Random,
    ) -> None:
        """Create a servo.

        Args:
            model: servo model.
            settings: raw EEPROM values that differ from the factory values.
            start: shaft position at time 0, pulses, unfolded (see `Encoder`).
            boot_time: time for which the servo does not answer after a reboot, s.
            random: source of the measurement noise.
        """
        self.model, self._boot_time, self._random = model, boot_time, random
        self.load, self.voltage, self.ambient, self.blocked = 0.0, 12.0, 25.0, False
        self.memory = RegisterMemory(model, settings)
        self.motor: MotorState = motor.at_rest(start)
        self._yield = Yield()
        self._time = 0.0
        self._silent_until = 0.0
        self._power_up()

    # --- life ---------------------------------------------------------------------------------

    def reboot(self, time: float) -> None:
        """Boot, after a reboot or at power-up: RAM is reset, torque is off, the position is folded to one turn."""
        self._silent_until = time + self._boot_time
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

    def _apply(self, row: VirtualRegister, value: int) -> None:
        """Set one register and apply its side effects."""
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

    # --- position -----------------------------------------------------------------------------

    @property
    def _encoder(self) -> Encoder:
        return Encoder(self._direction, self._folded_turns, self.memory["homing_offset"])

    @property
    def _direction(self) -> int:
        return -1 if self.memory["drive_mode"] & REVERSE_DRIVE else 1

    def _fold(self) -> None:
        """Remove the whole turns from Present Position."""
        counted = math.floor(self._direction * self.shaft.position)
        self._folded_turns = counted // PULSES_PER_TURN

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
        command = self._command
        if self.blocked:
            command = command._replace(kind=motor.BLOCKED)
        if command.kind == motor.LIMP and self._yield.distance:
            self.motor, self._yield = self.shaft, Yield()
        self.motor = motor.step(self.motor, command, self.load, self.model, step_s)
        if self.load or self._yield.distance:
            self._yield = motor.step_yield(self._yield, command, self.load, step_s)

    def _stop_by_watchdog(self) -> None:
        for name in ("profile_velocity", "profile_acceleration", "goal_velocity"):
            self.memory[name] = 0
        self.memory["bus_watchdog"] = -1
        goal = self.memory["goal_position"]
        self._hold()
        self.memory["goal_position"] = goal  # The watchdog does not change this register.

    def _update_command(self) -> None:
        """Compute the motor command from the registers, so that a step need not decode them."""
        memory, model = self.memory, self.model
        armed = memory["bus_watchdog"] > 0 and memory["torque_enable"]
        self._watchdog_time = memory["bus_watchdog"] * _WATCHDOG_UNIT if armed else math.inf
        no_load_speed = model.no_load_speed * RPM * self.voltage / model.nominal_voltage
        full_speed = no_load_speed * PULSES_PER_RADIAN
        speed = self._speed_goal(full_speed)
        kind = motor.POSITION if speed is None else motor.VELOCITY
        self._command = MotorCommand(
            kind if memory["torque_enable"] else motor.LIMP,
            self._goal if speed is None else speed,
            memory["profile_acceleration"] * _ACCELERATION_UNIT or math.inf,
            memory["profile_velocity"] * SPEED_UNIT or math.inf,
            full_speed * min(abs(memory["goal_pwm"]), memory["pwm_limit"]) / FULL_PWM,
            self._compliance() if memory["torque_enable"] and speed is None else 0.0,
        )

    def _speed_goal(self, full_speed: float) -> float | None:
        """Return the commanded speed, pulses/s; None if the motor controls its position.

        The motor controls its position in the position modes and, after the Bus Watchdog has fired, in all modes. The
        driver uses no other mode: a servo on which another program left one turns away when its torque goes on.
        """
        memory = self.memory
        if memory["bus_watchdog"] < 0:
            return None
        if memory["operating_mode"] == VELOCITY_MODE:
            return self._direction * memory["goal_velocity"] * SPEED_UNIT
        if memory["operating_mode"] == PWM_MODE:
            return self._direction * memory["goal_pwm"] / FULL_PWM * full_speed
        return None

    def _compliance(self) -> float:
        """Return the position error per load of the position controller, pulses/(N*m).

        Without an integral part the controller holds a load only by an error: the PWM output is the P gain times the
        error, and full output holds the stall torque. With the factory gain 800, full output needs an error of 142
        pulses. On an XM430 with a spool of 25 mm this is 3.3 mm of cable per 100 N. The friction of the gear is
        neglected.
        """
        if self.memory["position_i_gain"]:
            return 0.0
        gain = max(self.memory["position_p_gain"], 1) * _GAIN_UNIT
        return FULL_PWM / gain / self.model.stall_torque

    # --- measurements and protections ---------------------------------------------------------

    def supervise(self, duration: float) -> None:
        """Update the protections for the duration (s) since the last call."""
        memory, bits = self.memory, 0
        overloaded = abs(self._torque()) >= _OVERLOAD_LEVEL * self._strongest_torque()
        self._overload = self._overload + duration if overloaded else 0.0
        if not memory["min_voltage_limit"] <= self._raw_voltage <= memory["max_voltage_limit"]:
            bits |= INPUT_VOLTAGE_ERROR
        if self.ambient + _HEAT > memory["temperature_limit"]:
            bits |= OVERHEATING_ERROR
        if self._overload >= _OVERLOAD_TIME:
            bits |= OVERLOAD_ERROR
        if bits:
            self.raise_alert(bits)

    def raise_alert(self, bits: int) -> None:
        """Set bits of Hardware Error Status, and shut down if the Shutdown mask contains them."""
        self.memory["hardware_error_status"] |= bits
        if bits & self.memory["shutdown"]:
            self.memory["torque_enable"] = 0
            self._shut_down = True
            self._update_command()

    @property
    def _raw_voltage(self) -> int:
        return max(round(self.voltage * 10), 0)

    def _strongest_torque(self) -> float:
        """Return the motor's largest torque, N*m."""
        model = self.model
        if "current_limit" not in self.memory:
            return model.stall_torque
        limit = self.memory["current_limit"] * model.current_unit * model.torque_constant
        return min(limit, model.stall_torque)

    def _torque(self) -> float:
        """Return the motor torque, N*m; positive when it acts forward, against the load or the obstacle."""
        command = self._command
        if command.kind == motor.LIMP:
            return 0.0
        if not self.blocked:
            return self.load
        if command.kind == motor.VELOCITY:
            share = math.copysign(1.0, command.goal) if command.goal else 0.0
        else:
            error = (command.goal - self.motor.position) / PULSES_PER_RADIAN
            share = min(max(error / _BLOCKED_ERROR, -1.0), 1.0)
        return share * self._strongest_torque()

    def _measure(self) -> None:
        """Write the measured values into their registers."""
        memory, model, encoder, shaft = self.memory, self.model, self._encoder, self.shaft
        noise = self._random.gauss(0.0, 1.0) if memory["torque_enable"] else 0.0
        torque = encoder.direction * self._torque()
        if model.measures_current:
            counts = torque / model.torque_constant / model.current_unit + noise
            memory["present_current"] = round(min(max(counts, -32767), 32767))
        else:
            share = torque / model.stall_torque * 1000 + noise
            memory["present_load"] = round(min(max(share, -1000), 1000))
        memory["present_velocity"] = encoder.direction * round(shaft.velocity / SPEED_UNIT)
        memory["present_position"] = encoder.raw(shaft.position)
        memory["position_trajectory"] = encoder.raw(shaft.trajectory_position)
        memory["realtime_tick"] = int((self._time - self._booted_at) * 1000) % _TICK_WRAP
        memory["present_input_voltage"] = self._raw_voltage
        memory["present_temperature"] = min(round(self.ambient + _HEAT), 255)
