# SPDX-License-Identifier: Apache-2.0
"""Rows of ``worm check`` on the servo bus and the power sensor: what is known before torque is switched on.

Nothing is written to a servo or to the sensor. Each row applies the rules that the driver applies at configure.
"""

import contextlib
import enum
import errno
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

from worm_driver.clock import Clock
from worm_driver.control import actuators, diagnostics
from worm_driver.control.diagnostics import Level
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.driver_errors import (
    BusError,
    ConfigurationError,
    DriverError,
    NoReplyError,
    PowerSensorError,
)
from worm_driver.power import i2c, ina219
from worm_driver.power.ina219 import INA219, PowerSample, SampleStatus
from worm_driver.servos import serial_port
from worm_driver.servos import servo_setup as servos
from worm_driver.servos.registers import BAUD_RATES, ServoModel
from worm_driver.servos.servo_bus import Identity, ServoBus
from worm_driver.servos.servo_setup import Servo

#: Rows of `tracking.camera_check`.
CAMERA_ROWS = ("camera rate", "camera delay", "markers")
#: Bits of hardware_error_status that the rows "supply voltage" and "temperatures" report.
_VOLTAGE_ERROR, _HEAT_ERROR = 1 << 0, 1 << 2
#: Period of the power samples, s. It is longer than a conversion.
_SAMPLING = 0.01
#: Standard deviation of the power at rest, W, above which the idle power, the mean of ten samples, is uncertain by more
#: than 0.05 W, which is 6 % of the paper's idle power.
_NOISY = 0.15


class State(enum.Enum):
    """State of a row."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"
    SKIPPED = "skipped"


@dataclass(frozen=True)
class Row:
    """Row of the table: name of the check, its state, what was found, and what to do about it (empty: nothing)."""

    name: str
    state: State
    found: str
    remedy: str = ""


class AdviceError(DriverError):
    """A problem in spite of which the robot can be switched on."""


#: Check that returns what it found (None: nothing to show), or raises DriverError: problem, colon and remedy.
Check = Callable[[], str | None]


def judge(name: str, checks: Iterable[Check]) -> Row:
    """Return the row of some checks. Without checks, the row is skipped."""
    found: list[str | None] = []
    problems: dict[str, str] = {}
    failed = False
    for check in checks:
        try:
            found.append(check())
        except DriverError as error:
            problem, _, remedy = str(error).partition(": ")
            problems[problem] = remedy
            failed = failed or not isinstance(error, AdviceError)
    if problems:
        state = State.FAILED if failed else State.WARNING
        remedies = dict.fromkeys(filter(None, problems.values()))
        return Row(name, state, "; ".join(problems), "; ".join(remedies))
    if not found:
        return Row(name, State.SKIPPED, "nothing that could be read")
    return Row(name, State.OK, ", ".join(filter(None, found)) or "ok")


def fail(error: DriverError) -> None:
    """Raise an error, as a check that is known to fail."""
    raise error


def _each(check: Callable[[int], str | None], numbers: Iterable[int]) -> Iterator[Check]:
    """Yield a check of each servo. Nothing is read from ``numbers`` before the first of them is needed."""
    for number in numbers:
        yield partial(check, number)


def skipped(names: Iterable[str], why: str) -> list[Row]:
    """Return rows that are skipped, with the reason."""
    return [Row(name, State.SKIPPED, why) for name in names]


# --- the serial port ------------------------------------------------------------------------------

_PORT, _PERMISSIONS, _LATENCY = "port", "permissions", "latency timer"


def open_port(settings: DriverSettings) -> tuple[ServoBus | None, list[Row]]:
    """Open the servo bus. Return it (None if it cannot be opened) and the rows on its port."""
    try:
        bus = ServoBus.open(settings.port, settings.baud_rate)
    except DriverError as error:
        forbidden = getattr(error.__cause__, "errno", None) == errno.EACCES
        failed = judge(_PERMISSIONS if forbidden else _PORT, [partial(fail, error)])
        others = skipped((_PORT, _PERMISSIONS, _LATENCY), "the port cannot be opened")
        return None, [failed if row.name == failed.name else row for row in others]
    rows = [
        Row(_PORT, State.OK, f"{settings.port} at {settings.baud_rate} bit/s"),
        Row(_PERMISSIONS, State.OK, f"{settings.port} can be read and written"),
    ]
    timer = serial_port.latency_timer_ms(settings.port)
    if timer is None:
        return bus, rows + skipped([_LATENCY], "the port has none")
    return bus, [*rows, judge(_LATENCY, [partial(_timer, settings, timer)])]


def _timer(settings: DriverSettings, timer: int) -> str:
    serial_port.require_latency(settings.port, timer * 1e-3, settings.period)
    if timer > 1:
        raise AdviceError(f"{timer} ms instead of 1: install the udev rule (99-worm.rules)")
    return f"{timer} ms"


# --- the servos -----------------------------------------------------------------------------------


class ServoCheck:
    """Checks of the servos on an open bus.

    Args:
        settings: settings of the driver.
        bus: servo bus.

    Attributes:
        servos: servos that could be read, by id.
    """

    NAMES = (
        *("ids", "models", "firmware", "registers", "supply voltage", "hardware errors"),
        *("temperatures", "torque"),
    )

    def __init__(self, settings: DriverSettings, bus: ServoBus):
        self._settings, self._bus = settings, bus
        self._identities: dict[int, Identity] = {}
        self._models: dict[int, ServoModel] = {}
        self._protections: dict[int, Mapping[str, int]] = {}
        self._health: dict[int, Mapping[str, int]] = {}
        self.servos: dict[int, Servo] = {}

    def rows(self) -> list[Row]:
        """Return all rows, in the order of `NAMES`."""
        columns = (
            self._ids(),
            _each(self._model, self._identities),
            _each(self._firmware, self._models),
            self._registers(),
            _each(self._supply, self._health),
            _each(self._errors, self._health),
            _each(self._heat, self._health),
            self._torque(),
        )
        with self._bus.retrying():
            return [judge(name, checks) for name, checks in zip(self.NAMES, columns, strict=True)]

    def _ids(self) -> Iterator[Check]:
        settings = self._settings
        wanted = (*settings.cable_ids, *settings.fin_ids)
        problem, answering = self._scan()
        if not (answering or problem):
            yield self._search
            return
        for number in wanted:
            yield partial(self._ping, number)
        if problem:
            yield partial(fail, problem)
        if others := ", ".join(str(n) for n in answering if n not in wanted):
            text = (
                f"ids {others} answer, too: name these servos in the parameter file, or remove them"
            )
            yield partial(fail, AdviceError(text))

    def _scan(self) -> tuple[DriverError | None, dict[int, Identity]]:
        """Return the servos that answer, or why their answers are unusable also in a second attempt."""
        problem: DriverError | None = None
        for _ in range(2):
            try:
                if answering := self._bus.scan():
                    return None, answering
            except BusError as error:
                problem = error
        return problem, {}

    def _ping(self, number: int) -> str:
        self._identities[number] = self._bus.ping(number)
        return str(number)

    def _search(self) -> str:
        """Raise an error that names the baud rate at which servos answer, if there is one."""
        usual = self._settings.baud_rate
        try:
            for rate in BAUD_RATES:
                self._bus.set_baud_rate(rate)
                if ids := ", ".join(map(str, self._bus.scan())):
                    raise ConfigurationError(
                        f"no servo answers at {usual} bit/s, but ids {ids} do at {rate}: set baud_rate to {rate}, or "
                        "the servos to the other rate (setup_servo)"
                    )
        finally:
            self._bus.set_baud_rate(usual)
        raise ConfigurationError(
            "no servo answers at any baud rate: is their supply on (emergency switch), and the data cable connected?"
        )

    def _model(self, number: int) -> str:
        self._models[number] = servos.model_of(number, self._identities[number])
        return f"{number} {self._models[number].name}"

    def _firmware(self, number: int) -> str:
        version = self._identities[number].firmware
        servos.require_watchdog(number, self._models[number], version)
        return str(version)

    def _registers(self) -> Iterator[Check]:
        for number, model in self._models.items():
            yield partial(self._read, number, model)
            if servo := self.servos.get(number):
                yield partial(servos.require_protections, servo, self._protections[number])
                yield partial(actuators.require_registers, self._bus, servo, self._settings)
                yield partial(self._left_over, servo)

    def _read(self, number: int, model: ServoModel) -> None:
        firmware = self._identities[number].firmware
        names = ("hardware_error_status", "present_input_voltage", "present_temperature")
        try:
            servo, self._protections[number] = servos.read_servo(self._bus, number, model, firmware)
            self._health[number] = servos.registers(self._bus, servo, *names, "torque_enable")
        except NoReplyError:
            raise AdviceError(
                f"servo {number} answers pings, but no reading of its registers (status_return_level 0?): configure "
                "the driver, which sets this register, then check again"
            ) from None
        self.servos[number] = servo

    def _left_over(self, servo: Servo) -> None:
        weak = servo.number in self._settings.cable_ids and not servo.model.measures_current
        limit = actuators.own_limit(servo, self._settings) if weak else 1.0
        if left := servos.left_over(self._bus, servo, limit):
            raise AdviceError(
                f"servo {servo.number} has {left}: the driver sets these values itself"
            )

    def _supply(self, number: int) -> str:
        servo, health = self.servos[number], self._health[number]
        voltage = servo["present_input_voltage"].from_raw(health["present_input_voltage"])
        servos.require_supply(servo, voltage)
        servos.require_no_error(servo, health["hardware_error_status"] & _VOLTAGE_ERROR)
        return f"{number} {voltage:.1f} V"

    def _errors(self, number: int) -> None:
        status = self._health[number]["hardware_error_status"]
        servos.require_no_error(self.servos[number], status & ~(_VOLTAGE_ERROR | _HEAT_ERROR))

    def _heat(self, number: int) -> str:
        servo, health = self.servos[number], self._health[number]
        servos.require_no_error(servo, health["hardware_error_status"] & _HEAT_ERROR)
        if hot := diagnostics.heat(servo, health["present_temperature"]):
            raise AdviceError(f"servo {number} has {hot}: let it cool, and look for a load on it")
        return f"{number} {health['present_temperature']} degC"

    def _torque(self) -> Iterator[Check]:
        cables = [self.servos.get(number) for number in self._settings.cable_ids]
        if all(cables):
            yield partial(self._held, [servo for servo in cables if servo])

    def _held(self, cables: list[Servo]) -> str:
        contraction = actuators.held_contraction(self._bus, cables, self._settings)
        if contraction is not None:
            raise AdviceError(": ".join(actuators.left_on(contraction).split("; ", 1)))
        on = [str(n) for n, health in self._health.items() if health["torque_enable"]]
        if on:
            raise AdviceError(
                f"the torque of {', '.join(on)} is on: end the program that uses it; configure releases it"
            )
        return "off"


# --- the power sensor -----------------------------------------------------------------------------


class SensorCheck:
    """Checks of the power sensor.

    Args:
        settings: settings of the driver.
        clock: clock of the sensor.
    """

    NAMES = ("power sensor", "power sensor calibration", "current sign", "current noise")

    def __init__(self, settings: DriverSettings, clock: Clock):
        self._settings, self._clock = settings, clock
        self._valid: list[PowerSample] = []
        self._stored = 0

    def rows(self) -> list[Row]:
        """Return all rows, in the order of `NAMES`."""
        if not self._settings.has_sensor:
            return skipped(self.NAMES, "i2c_bus is none")
        with contextlib.ExitStack() as opened:
            rows = [judge(self.NAMES[0], [partial(self._presence, opened)])]
            for name, check in zip(
                self.NAMES[1:], (self._calibration, self._sign, self._noise), strict=True
            ):
                rows.append(judge(name, [check] if self._valid else []))
        return rows

    def _presence(self, opened: contextlib.ExitStack) -> str:
        settings = self._settings
        device = i2c.open_device(settings.i2c_bus, settings.i2c_address)
        opened.callback(device.close)
        sensor = INA219(device, settings.shunt_resistance, 0)
        configuration = device.read(ina219.CONFIGURATION)
        usual = ina219.POWER_ON_CONFIGURATION, ina219.RUNNING_CONFIGURATION
        if i2c.swap(configuration) in usual:
            raise sensor.other_chip(configuration)
        self._stored = device.read(ina219.CALIBRATION)
        samples = []
        for _ in range(ina219.FROZEN):
            self._clock.sleep_until(self._clock() + _SAMPLING)
            samples.append(sensor.look(self._clock()))
        self._valid = [sample for sample in samples if sample.status is SampleStatus.VALID]
        counts = Counter(sample.status for sample in samples)
        where = f"INA219 0x{settings.i2c_address:02X} on {settings.i2c_bus}"
        report = diagnostics.power_report(counts, where, "")
        if report.level is not Level.OK:
            kind = AdviceError if self._valid else PowerSensorError
            raise kind(f"{report.message}: check its supply, its wiring and the parameters ina219")
        if configuration not in usual:
            raise AdviceError(
                f"configuration 0x{configuration:04X}, left by another program or of "
                "another chip: the driver resets and checks it"
            )
        return where

    def _calibration(self) -> str:
        settings = self._settings
        needed = ina219.calibration_for(settings.shunt_resistance, settings.max_current)
        if self._stored not in (0, needed):
            raise AdviceError(
                f"{self._stored} instead of {needed}, left by another program: the driver sets it"
            )
        return f"{needed} for {settings.max_current:g} A and {settings.shunt_resistance:g} ohm"

    def _sign(self) -> str:
        if reversed_current := ina219.reversed_current(self._valid):
            raise ConfigurationError(reversed_current)
        return f"{statistics.fmean(s.current for s in self._valid):.3f} A"

    def _noise(self) -> str:
        power = [sample.power for sample in self._valid]
        spread = statistics.pstdev(power)
        text = f"{statistics.fmean(power):.2f} W, standard deviation {spread:.3f} W"
        if spread > _NOISY:
            raise AdviceError(
                f"{text}: check the supply and the wires of the sensor; is a servo moving?"
            )
        return text
