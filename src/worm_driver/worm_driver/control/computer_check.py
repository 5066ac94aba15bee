# SPDX-License-Identifier: Apache-2.0
"""Rows of ``worm check`` on the computer: its timing, disk and clock, the ROS domain, and other graphs in it."""

import ctypes
import shutil
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from worm_driver.control import diagnostics
from worm_driver.control.bench_check import AdviceError, Check
from worm_driver.control.control_loop import PeriodicThread
from worm_driver.control.diagnostics import Level
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.real_time import NOT_REQUESTED, request_scheduling, return_to_normal
from worm_driver.driver_errors import ConfigurationError
from worm_msgs.claim import ClaimedError, claim, domain_of
from worm_msgs.network import NetworkError, bind

#: Duration of the trial of the rate, s.
_TRIAL = 2.0
#: Free space of the folder of the recordings, bytes: a day and ten minutes of a recording at 40 kB/s.
_DAY, _TEN_MINUTES = 3_500_000_000, 25_000_000
#: Earliest plausible time, s since 1970: 1 January 2025. A computer without a battery for its clock starts before it.
_EARLIEST = 1_735_689_600
_TIMEX_SIZE = 256  # bytes, more than struct timex of adjtimex(2) has
_UNSYNCHRONISED = 5  # TIME_ERROR, adjtimex(2)
#: Checks that do not apply to a virtual robot, whose time waits for its driver.
OF_REAL_TIME = ("rate", "clock")
_DEFAULT_MIDDLEWARE = "rmw_fastrtps_cpp"


class RateTrial(PeriodicThread):
    """Thread that exchanges the bytes of a control cycle at the driver's rate, with its real-time priority.

    Args:
        settings: settings of the driver.
        exchange: called in each cycle, for example to read the state of all servos.
    """

    def __init__(self, settings: DriverSettings, exchange: Callable[[], object]):
        super().__init__("rate", settings.period)
        self._settings, self._exchange = settings, exchange
        self._scheduling = NOT_REQUESTED

    def _at_start(self) -> None:
        self._scheduling = request_scheduling(self._settings.real_time_priority)

    def _step(self, _: float) -> bool:
        self._exchange()
        return self._meter.cycles < _TRIAL / self._meter.period

    def _at_end(self) -> None:
        return_to_normal()

    def result(self) -> str:
        """Run the trial and return its result. Raises AdviceError if the computer does not keep the rate."""
        self._run()
        if self.failure is not None:
            raise self.failure
        timing = self._meter.report()
        report = diagnostics.timing_report(timing, self._settings.period, self._scheduling)
        if report.level is not Level.OK:
            raise AdviceError(report.message)
        if not self._scheduling.granted:
            raise AdviceError(self._scheduling.description)
        return (
            f"{self._settings.rate:g} Hz, p99 of the period error {timing.p99_error * 1e3:.2f} ms"
        )


def disk(folder: Path) -> str:
    """Return the free space of the folder in which recordings are stored."""
    free = shutil.disk_usage(folder).free
    text = f"{free / 1e9:.1f} GB free in {folder}"
    if free < _TEN_MINUTES:
        raise ConfigurationError(f"{text}: make room, a recording needs 0.15 GB an hour")
    if free < _DAY:
        raise AdviceError(f"{text}: make room, a recording needs 0.15 GB an hour")
    return text


def clock(now: float, status: int) -> str:
    """Return the state of the computer's clock.

    Args:
        now: time of the clock, s since 1970.
        status: result of adjtimex(2).
    """
    text = time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(now))
    if now < _EARLIEST:
        raise ConfigurationError(f"the clock shows {text}: set it (timedatectl)")
    if status == _UNSYNCHRONISED:
        raise AdviceError(
            f"{text}, not synchronised, so the stamps of a recording may jump: sudo timedatectl set-ntp true"
        )
    return text


def clock_status() -> int:
    """Return the result of adjtimex(2), which is not asked to change the clock."""
    return int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_SIZE)))


def ros_domain(environment: Mapping[str, str]) -> str:
    """Return the ROS domain of an environment and who can reach it."""
    middleware = environment.get("RMW_IMPLEMENTATION") or _DEFAULT_MIDDLEWARE
    try:
        access = bind(dict(environment), middleware)
    except NetworkError as error:
        raise ConfigurationError(": ".join(str(error).split("; ", 1))) from None
    if not access.is_local:
        raise AdviceError(str(access))
    return f"{domain_of(environment)}, {access}"


def other_graph(namespace: str, domain: int, roles: tuple[str, ...]) -> str:
    """Return that no process of this computer has one of the roles of a graph in a namespace of a ROS domain."""
    try:
        for role in roles:
            claim(role, namespace, domain).close()
    except ClaimedError as error:
        raise ConfigurationError(": ".join(str(error).split(". ", 1))) from None
    return f"none in /{namespace.strip('/')}, domain {domain}, on this computer"


def computer_checks(
    settings: DriverSettings,
    environment: Mapping[str, str],
    namespace: str,
    roles: tuple[str, ...],
    exchange: Callable[[], object],
) -> dict[str, Check]:
    """Return the checks of the computer by the names of their rows.

    Args:
        settings: settings of the driver.
        environment: environment variables.
        namespace: namespace of the driver.
        roles: roles that no other process may have in this namespace.
        exchange: see `RateTrial`.
    """
    return {
        "rate": RateTrial(settings, exchange).result,
        "disk": partial(disk, Path.cwd()),
        "clock": lambda: clock(time.time(), clock_status()),
        "ROS domain": partial(ros_domain, environment),
        "other graph": partial(other_graph, namespace, domain_of(environment), roles),
    }
