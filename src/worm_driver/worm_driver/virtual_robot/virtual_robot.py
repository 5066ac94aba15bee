# SPDX-License-Identifier: Apache-2.0
"""Virtual robot: servos, plant, power sensor, camera and faults on a common simulated clock.

No method reads a clock: time is an argument. Equal settings and equal bytes at equal times produce exactly equal
results.
"""

import errno
import math
from dataclasses import dataclass, replace
from random import Random

from worm_driver.power import socket_smbus as frames
from worm_driver.power.socket_smbus import Answer, Request
from worm_driver.servos.registers import EXTENDED_POSITION_MODE, POSITION_MODE
from worm_driver.virtual_robot.plant import LOOSE, Plant, make_grooves
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN
from worm_driver.virtual_robot.servo.virtual_servo import OVERLOAD_ERROR, Servo
from worm_driver.virtual_robot.virtual_bus import ServoBus, Transmission
from worm_driver.virtual_robot.virtual_settings import (
    CableServoSettings,
    FinServoSettings,
    RobotSettings,
    TrackerSettings,
)
from worm_driver.virtual_robot.wire.faults import FaultBoard
from worm_driver.virtual_robot.wire.ina219_chip import Ina219
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import FORWARD, REVERSE


@dataclass(frozen=True)
class TrackerSample:
    """Positions measured in one exposure.

    Attributes:
        time: time of the exposure, s.
        rear_position, front_position: x1 and x2, m; NaN while the marker is hidden.
    """

    time: float
    rear_position: float
    front_position: float


class Tracker:
    """Camera with a fixed rate. The zero of both positions is the initial position of the rear module without a load.

    Attributes:
        next_exposure: time of the next exposure, s.
    """

    def __init__(self, settings: TrackerSettings, random: Random) -> None:
        self._settings = settings
        self._random = random
        self._exposures = 0
        self._hidden_until = [0.0, 0.0]
        self.next_exposure = 0.0

    def expose(self, time: float, rear: float, front: float) -> TrackerSample:
        """Return a noisy sample of the true positions x1 and x2 (m) at a time (s)."""
        self._exposures += 1
        self.next_exposure = self._exposures / self._settings.rate
        positions = [self._see(marker, time, true) for marker, true in enumerate((rear, front))]
        return TrackerSample(time, *positions)

    def _see(self, marker: int, time: float, true: float) -> float:
        # Both numbers are drawn each time, so that an occlusion does not change the noise after it.
        starts = self._random.random() < self._settings.occlusion_rate / self._settings.rate
        noise = self._random.gauss(0.0, self._settings.noise)
        if starts and time >= self._hidden_until[marker]:
            self._hidden_until[marker] = time + self._settings.occlusion
        return math.nan if time < self._hidden_until[marker] else true + noise


_HOUSEKEEPING = 0.005  # s, time between two updates of the faults
_SUPERVISION = 0.050  # s, time between two checks of the servos' protections
_TOO_HOT = 100.0  # degC, rise of the ambient temperature during the fault overheating


class VirtualRobot:
    """Virtual robot that starts at time 0 (s), at rest, with torque off.

    Attributes:
        board: injected faults.
        plant: body, pipe and conditions.
        state: state of the plant.
        servos: cable servos, then fin servos, in the order of the settings.
        chip: power sensor.
        laws: directions in which the rear and the front fins slide, see `Plant.step`.
        bus_voltage: supply voltage at the power sensor, V.
    """

    def __init__(self, settings: RobotSettings, board: FaultBoard | None = None) -> None:
        self.settings = settings
        self.board = FaultBoard() if board is None else board
        self.plant = _make_plant(settings)
        self._cable = [
            (item, self._make_servo(item, EXTENDED_POSITION_MODE)) for item in settings.cable_servos
        ]
        self._fins = [(item, self._make_servo(item, POSITION_MODE)) for item in settings.fin_servos]
        self.servos = tuple(servo for _, servo in [*self._cable, *self._fins])
        self._bus = ServoBus(self.servos, self.board, self._random("fuzz"))
        sensor = settings.power_sensor
        self.chip = Ina219(sensor.shunt_noise, sensor.bus_noise, self._random("sensor"))
        self._tracker = Tracker(settings.tracker, self._random("tracker"))
        self._ripple = self._random("ripple")
        self._samples: list[TrackerSample] = []
        self._vanished: set[int] = set()
        self.laws = (LOOSE, LOOSE)
        self._fin_positions: list[float] = []
        self._extra_current = 0.0
        self._steps = 0
        self._next_housekeeping = 0.0
        self._next_supervision = 0.0
        self.bus_voltage = settings.supply.voltage
        self._set_laws()
        self.state = self.plant.at_rest(self.laws)

    def _random(self, purpose: str) -> Random:
        return Random(f"{self.settings.seed} {self.settings.recording} {purpose}")

    def _make_servo(self, item: CableServoSettings | FinServoSettings, mode: int) -> Servo:
        eeprom = {
            "id": item.id,
            "baud_rate": BAUD_RATES.index(self.settings.line.baud_rate),
            "return_delay_time": 0,
            "operating_mode": mode,
        }
        return Servo(
            item.model,
            eeprom,
            item.start_angle * PULSES_PER_RADIAN,
            self.settings.line.boot_time,
            self._random(f"servo {item.id}"),
        )

    # --- interface ------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time (s) of the last step, 0 at the start."""
        return self._steps * self.settings.step

    def advance(self, time: float) -> None:
        """Simulate until a time (s)."""
        last = int(time / self.settings.step + 1e-9)
        while self._steps < last:
            self._step()

    def receive(self, data: bytes, time: float, baud_rate: int | None = None) -> list[Transmission]:
        """Return the servos' answers to bytes sent at a time (s) and baud rate (bit/s; None: the correct one)."""
        self.advance(time)
        return self._bus.feed(data, time, baud_rate)

    def transact(self, request: Request, time: float) -> Answer:
        """Execute a transaction of the I2C bus, which acknowledges only the power sensor, at a time (s)."""
        self.advance(time)
        if hang := self.board.consume("i2c_timeout", time):
            return Answer(errno.ETIMEDOUT, delay=hang.value)
        address = self.settings.power_sensor.address
        if request.address != address or self.board.consume("i2c_nack", time):
            return Answer(errno.EREMOTEIO)
        if request.operation == frames.WRITE:
            # The chip accepts exactly two bytes per register, most significant byte first.
            if len(request.data) == 2:
                self.chip.write(request.register, int.from_bytes(request.data, "big"))
            return Answer(0)
        return Answer(0, self.chip.read(request.register).to_bytes(2, "big"))

    def take_samples(self) -> list[TrackerSample]:
        """Remove and return the camera samples."""
        samples, self._samples = self._samples, []
        return samples

    # --- one step -------------------------------------------------------------------------------

    def _step(self) -> None:
        step_s = self.settings.step
        self._steps += 1
        time = self._steps * step_s
        pull = max(self.state.cable_force, 0.0) / len(self._cable)
        for item, servo in self._cable:
            servo.load = item.sign * pull * item.spool_radius
        for servo in self.servos:
            servo.step(time, step_s)
        self._set_laws()
        self.state = self.plant.step(self.state, self.cable_change, self.laws)
        self._measure_power(time)
        if time >= self._tracker.next_exposure:
            self._samples.append(self._expose(time))
        if time >= self._next_housekeeping:
            self._keep_house(time)

    def _expose(self, time: float) -> TrackerSample:
        sample = self._tracker.expose(time, *self.plant.positions(self.state))
        if self.board.active("occluded", time) is None:
            return sample
        return replace(sample, rear_position=math.nan, front_position=math.nan)

    @property
    def cable_change(self) -> float:
        """Displacement of the cable since the start, m; negative when the servos have wound it up."""
        wound = sum(
            item.sign * (servo.motor_angle - item.start_angle) * item.spool_radius
            for item, servo in self._cable
        )
        return -wound / len(self._cable)

    def _set_laws(self) -> None:
        positions = [servo.motor.position for _, servo in self._fins]
        if positions != self._fin_positions:
            self._fin_positions = positions
            self.laws = (self._law("rear"), self._law("front"))

    def _law(self, module: str) -> int:
        """Return the direction in which a module's fins slide; LOOSE unless all its servos are set to one direction."""
        laws = {self._fin_law(item, servo) for item, servo in self._fins if item.module == module}
        return laws.pop() if len(laws) == 1 else LOOSE

    def _fin_law(self, item: FinServoSettings, servo: Servo) -> int:
        tolerance = self.settings.fin_tolerance
        if abs(servo.motor_angle - item.forward_angle) <= tolerance:
            return FORWARD
        return REVERSE if abs(servo.motor_angle - item.reverse_angle) <= tolerance else LOOSE

    def _measure_power(self, time: float) -> None:
        supply = self.settings.supply
        power = self.plant.electrical_power(self.state)
        power = max(power + self._ripple.gauss(0.0, supply.power_noise), 0.0)
        current = power / self.bus_voltage + self._extra_current
        # The current is computed from the voltage of the previous step; this converges within a few steps.
        self.bus_voltage = max(supply.voltage - supply.resistance * current, 0.5 * supply.voltage)
        shunt = current * self.settings.power_sensor.shunt
        self.chip.advance(time, shunt, self.bus_voltage)

    # --- faults and protections -----------------------------------------------------------------

    def _keep_house(self, time: float) -> None:
        self._next_housekeeping = time + _HOUSEKEEPING
        for servo in self.servos:
            self._surround(servo, time)
        if time >= self._next_supervision:
            self._next_supervision = time + _SUPERVISION
            for servo in self.servos:
                servo.supervise(_SUPERVISION)
        self._disturb_sensor(time)
        self._load(time)
        if self.board.consume("put_back", time):
            self.state = self.plant.put_back(self.state)
        self.board.forget_past(time)

    def _load(self, time: float) -> None:
        conditions = self.settings.conditions
        for name, kind in (("slope_deg", "slope"), ("tether_n", "tether")):
            if fault := self.board.active(kind, time):
                low, high = CONDITION_ROWS[name]["low"], CONDITION_ROWS[name]["high"]
                value = min(max(getattr(conditions, name) + fault.value, low), high)
                conditions = replace(conditions, **{name: value})
        if conditions != self.plant.conditions:
            self.plant = replace(self.plant, conditions=conditions)

    def _surround(self, servo: Servo, time: float) -> None:
        board, servo_id = self.board, servo.servo_id
        low = board.active("input_voltage", time, servo_id)
        servo.voltage = self.bus_voltage if low is None else low.value
        hot = board.active("overheating", time, servo_id)
        servo.ambient = 25.0 if hot is None else 25.0 + _TOO_HOT
        servo.blocked = board.active("stalled", time, servo_id) is not None
        if board.active("overload", time, servo_id):
            servo.raise_alert(OVERLOAD_ERROR)
        vanished = board.active("vanished", time, servo_id) is not None
        if vanished != (servo_id in self._vanished):
            self._vanished ^= {servo_id}
            servo.reboot(time)  # without supply the torque is off at once

    def _disturb_sensor(self, time: float) -> None:
        overflow = self.board.active("ina219_overflow", time)
        surge = overflow or self.board.active("ina219_saturation", time)
        self._extra_current = 0.0 if surge is None else surge.value
        self.chip.forced_overflow = overflow is not None
        if self.board.consume("ina219_reset", time):
            self.chip.power_on()


def _make_plant(settings: RobotSettings) -> Plant:
    seed, body = settings.seed, settings.true_body
    rear, front = (make_grooves(body, settings.effects, 2 * seed + i) for i in range(2))
    return Plant(body, settings.effects, rear, front, settings.step, settings.conditions)
