# SPDX-License-Identifier: Apache-2.0
"""Times from a fault to a cable that stands still, and motions caused by wrong samples, on the virtual clock.

The results are the same on every machine.
"""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Callable, Mapping

from benchmarks.report import Row
from tests.helpers.driver_rig import (
    CABLE,
    Rig,
    instruction_packet,
    settings,
    shaft_lengths,
    two_spools,
)
from worm_driver.driver_errors import ConfigurationError
from worm_driver.gait.gait_player import Phase
from worm_driver.virtual_robot.wire.packet import Instruction

TITLE = "from a fault to a cable that stands still, and what bad data move"

#: s from the onset of a gait of 70 mm at 0.4 Hz to the fault: the cable contracts or extends, fast or slowly
MOMENTS = (0.30, 0.62, 0.90, 1.60, 2.10)
#: m/s, below which the cable stands still
STILL = 0.002
#: s, observed time after a fault
LOOKED = 1.0

#: late loop: share of the cycles that begin late, and their largest delay, s
LATE_SHARE, LATEST = 0.3, 0.030

Deed = Callable[[Rig], object]


def _injected(name: str, **arguments: object) -> Deed:
    return lambda rig: rig.inject(name, **arguments)


def _unplug(rig: Rig) -> None:
    rig.wire.unplugged = True


FAULTS: Mapping[str, Deed | None] = {
    "stop is called": lambda rig: rig.robot.stop(rig.clock.now, "stop"),
    "the cable servo is silent": _injected("no_answer", target=1, duration=5.0),
    "a fin servo is silent": _injected("no_answer", target=11, duration=5.0),
    "nothing answers": _injected("no_answer", duration=5.0),
    "all answers are garbled": _injected("corrupted_crc", duration=5.0),
    "answers are 12 ms late": _injected("late", duration=5.0, value=0.012),
    "answers are 45 ms late": _injected("late", duration=5.0, value=0.045),
    "a fin servo reports overload": _injected("overload", target=12),
    "the supply of the cable servo sags": _injected(
        "input_voltage", target=1, duration=5.0, value=4.0
    ),
    "the cable is blocked": _injected("stalled", target=1, duration=5.0),
    "the serial port is unplugged": _unplug,
    "the driver is killed": None,
}


def _cycle(rig: Rig, dice: random.Random | None) -> None:
    """Run one control cycle, with random delays if ``dice`` is given."""
    period = rig.settings.period
    rig.clock.now = (int(rig.clock.now / period + 1e-6) + 1) * period
    if dice is not None and dice.random() < LATE_SHARE:
        rig.clock.now += dice.uniform(0.0, LATEST)
    rig.advance(rig.clock.now)
    rig.snapshots.append(rig.robot.cycle(rig.clock.now))


def _stopping_time(deed: Deed | None, moment: float, dice: random.Random | None) -> float:
    """Return the time (s) from the fault to the last motion of the cable."""
    return _time_to_stand(Rig(), deed, moment, dice)


def _time_to_stand(rig: Rig, deed: Deed | None, moment: float, dice: random.Random | None) -> float:
    rig.activate()
    rig.start()
    rig.run(5.0, until=lambda snapshot: snapshot.player.phase is Phase.RUNNING)
    onset = rig.clock.now
    while rig.clock.now < onset + moment:
        _cycle(rig, dice)
    begin = rig.clock.now
    rig.speeds.clear()
    if deed is None:
        rig.advance(begin + LOOKED)
    else:
        deed(rig)
        while rig.clock.now < begin + LOOKED:
            _cycle(rig, dice)
    return max((time for time, speed in rig.speeds if speed > STILL), default=begin) - begin


#: id of a fin servo
FIN = 11
#: ticks by which a sample is wrong
JUMPS = (-12288, -4096, -1000, -600, -300, 300, 600, 1000, 4096, 12288)
#: ticks per cycle by which samples drift from the truth
DRIFTS = (2, 5, 20, 60, 110)
#: s after the begin of a shutdown at which the stop comes
STOPS = (0.0, 0.1, 0.3, 0.6, 1.0, 1.5)
#: s after the begin of a flip of the fins
FLIPS = (0.05, 0.15, 0.3, 0.45)


def _idle() -> Rig:
    rig = Rig()
    rig.activate()
    rig.run(0.2)
    return rig


def _running(moment: float) -> Rig:
    rig = Rig()
    rig.activate()
    rig.start()
    rig.run(5.0, until=lambda snapshot: snapshot.player.phase is Phase.RUNNING)
    rig.run(moment)
    return rig


def _metres(ticks: float) -> float:
    return abs(settings().spools[0].length_change(ticks))


def _moved(rig: Rig, deed: Deed, duration: float = LOOKED) -> float:
    """Return the largest distance (m) of the cable from its initial position."""
    rig.positions.clear()
    here = rig.cable.shaft.position
    deed(rig)
    rig.run(duration)
    return max(_metres(position - here) for _, position in rig.positions)


def _wrong(jump: int, **length: float) -> Deed:
    return _injected("wrong_position", target=CABLE, value=jump, **length)


def _drift(per_cycle: int) -> Deed:
    """Return an action: samples drift until a FAULT occurs, or by three turns."""

    def deed(rig: Rig) -> None:
        for step in range(12288 // per_cycle):
            rig.virtual.board.clear()
            _wrong(step * per_cycle, duration=1e6)(rig)
            if rig.run(rig.settings.period).player.phase is Phase.FAULT:
                break

    return deed


def _off_command(jump: int) -> float:
    """Return the largest difference (m) from the same gait without the wrong sample, within a second after it."""
    off = []
    for moment in MOMENTS:
        rig, healthy = _running(moment), _running(moment)
        _wrong(jump, count=1)(rig)
        rig.positions.clear()
        healthy.positions.clear()
        rig.run(LOOKED)
        healthy.run(LOOKED)
        pairs = zip(rig.positions, healthy.positions, strict=False)
        off.append(max(_metres(a[1] - b[1]) for a, b in pairs))
    return max(off)


def _largest_unnoticed(servo: int) -> int:
    """Return the largest persistent offset (ticks) of a servo, starting at rest, that causes no FAULT."""
    low, high = 0, 4096
    while high - low > 1:
        middle = (low + high) // 2
        rig = _idle()
        rig.inject("wrong_position", target=servo, value=middle, duration=1e6)
        noticed = rig.run(LOOKED).player.phase is Phase.FAULT
        low, high = (low, middle) if noticed else (middle, high)
    return low


def _stopped_while_closing(moment: float) -> tuple[float, float, int]:
    """Return the results of a stop during a shutdown.

    They are the time until the cable stands (s), its contraction (m), and the torque at the end.
    """
    rig = _running(1.0)
    rig.loop.shutdown("the driver ends")
    if moment:
        rig.run(moment)
    begin = rig.clock.now
    rig.speeds.clear()
    rig.loop.submit(lambda now: rig.robot.stop(now, "stop"), lifetime=math.inf)
    while not rig.ended:
        rig.run(rig.settings.period)
    rig.end()
    rig.advance(rig.clock.now + 1.0)
    stood = max((time for time, speed in rig.speeds if speed > STILL), default=begin) - begin
    contracted = _metres(rig.cable.shaft.position - rig.home_ticks)
    return stood, contracted, rig.cable.memory["torque_enable"]


def _flip_stopped(moment: float) -> tuple[float, float]:
    """Return for how long (s) and how far (rad) the fins still move after an emergency stop during a flip."""
    rig = Rig()
    rig.activate()
    rig.start(0.05, 0.4, cycles=1, direction=-1)
    rig.run(1.0, until=lambda snapshot: snapshot.player.phase is Phase.FLIPPING)
    rig.run(moment)
    fins, begin = rig.virtual.servos[1:], rig.clock.now
    before = [fin.motor_angle for fin in fins]
    rig.robot.stop(begin, "the emergency stop is on")
    last, farthest = begin, 0.0
    while rig.clock.now < begin + LOOKED:
        rig.run(rig.settings.period)
        if any(abs(fin.motor.velocity) > 10.0 for fin in fins):
            last = rig.clock.now
        farthest = max(
            farthest, *(abs(f.motor_angle - b) for f, b in zip(fins, before, strict=True))
        )
    return last - begin, farthest


def _fastest_return(dice: random.Random | None) -> float:
    """Return the largest speed (m/s) of the cable during a return to rest, mean over 30 ms."""
    rig = _running(1.2)
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(0.4)
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    rig.positions.clear()
    while not rig.robot.released:
        _cycle(rig, dice)
    pairs = zip(
        rig.positions, rig.positions[round(0.03 / rig.virtual.settings.step) :], strict=False
    )
    return max(_metres(b[1] - a[1]) / (b[0] - a[0]) for a, b in pairs)


#: m/s, limits of the cable speed
SPEEDS = (0.01, 0.02, 0.03, 0.12)
#: m, by which one of two cables differs in an activation
APART = (0.001, 0.002, 0.004)


def _released_at(speed: float) -> float:
    """Return the contraction (m) at which the torque goes off, with a limit of the cable speed (m/s)."""
    rig = Rig(settings(max_cable_speed=speed))
    rig.activate()
    rig.start(0.036, min(0.4, 0.95 * speed / math.pi / 0.036))
    rig.run(60.0, until=lambda snapshot: snapshot.player.length_change < -0.03)
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(0.5)
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    rig.run(20.0, until=lambda _: rig.robot.released)
    return -shaft_lengths(rig)[0]


def _repeated_stops() -> float:
    """Return the motion (m) of a holding, contracted cable during 100 stops."""
    rig = _running(0.9)
    rig.robot.stop(rig.clock.now, "stop")
    rig.run(LOOKED)

    def deed(rig: Rig) -> None:
        for _ in range(100):
            rig.robot.stop(rig.clock.now, "stop")
            rig.run(0.05)

    return _moved(rig, deed)


def _activated_apart(distance: float) -> float:
    """Return the largest motion (m) of two cables, whose lengths differ by a distance (m), in an activation."""
    rig = two_spools()
    servo = rig.virtual.servos[1]
    turned = servo.motor.position + rig.settings.spools[1].ticks(-distance)
    servo.motor = servo.motor._replace(position=turned)
    rig.run(0.1)
    before = shaft_lengths(rig)
    rig.robot.activate(rig.clock.now)
    rig.run(LOOKED)
    return max(abs(b - a) for a, b in zip(before, shaft_lengths(rig), strict=True))


def _stopped_apart(index: int) -> tuple[float, float]:
    """Return the results of a stop in a gait while one of two servos is slow, 6 mm/s.

    They are the time until both stand (s), and their largest motion (m) from 0.1 s after the stop on.
    """
    rig = two_spools()
    rig.activate()
    rig.start(0.06, 0.3)
    slow = rig.virtual.servos[index]
    register = slow.model.registers["profile_velocity"]
    slow.write(register.address, register.pack(10))
    rig.run(8.0, until=lambda _: abs(shaft_lengths(rig)[0] - shaft_lengths(rig)[1]) > 0.01)
    begin = rig.clock.now
    rig.speeds.clear()
    rig.robot.stop(begin, "stop")
    rig.run(0.1)
    before = shaft_lengths(rig)
    rig.run(2.0)
    last = max((time for time, speed in rig.speeds if speed > STILL), default=begin)
    moved = max(abs(b - a) for a, b in zip(before, shaft_lengths(rig), strict=True))
    return last - begin, moved


def _measured() -> list[Row]:
    released = [_released_at(speed) for speed in SPEEDS]
    apart = [_activated_apart(distance) for distance in APART]
    stops = [_stopped_apart(index) for index in (0, 1)]
    return [
        Row(
            "slow return: contracted when the torque goes off",
            f"{max(released) * 1e3:.1f} mm",
            "",
            f"worst of {len(SPEEDS)} limits of the cable speed, {SPEEDS[0]} to {SPEEDS[-1]} m/s",
        ),
        Row("100 stops in a hold: the cable moves", f"{_repeated_stops() * 1e3:.2f} mm", "", ""),
        Row(
            "two cables apart, activation: they move",
            f"{max(apart) * 1e3:.1f} mm",
            "",
            f"worst of {len(APART)} distances, {APART[0]} to {APART[-1]} m",
        ),
        Row(
            "two cables apart, stop: time until both stand",
            f"{max(time for time, _ in stops) * 1e3:.0f} ms",
            "",
            f"later they move by {max(moved for _, moved in stops) * 1e3:.1f} mm",
        ),
    ]


def _bad_data() -> list[Row]:
    once = max(_moved(_idle(), _wrong(jump, count=1)) for jump in JUMPS)
    confirmed = max(_moved(_idle(), _wrong(jump, duration=1e6)) for jump in JUMPS)
    running = max(_off_command(jump) for jump in JUMPS)
    stops = [_stopping_time(_wrong(jump, duration=1e6), 0.62, None) for jump in JUMPS]
    drift = max(_moved(_idle(), _drift(ticks)) for ticks in DRIFTS)
    offset, of_fin = _largest_unnoticed(CABLE), _largest_unnoticed(FIN)
    sizes = f"worst of {len(JUMPS)} sizes, {JUMPS[0]} to {JUMPS[-1]} ticks"
    return [
        Row("one wrong sample, idle: the cable moves", f"{once * 1e3:.2f} mm", "", sizes),
        Row(
            "wrong samples that last, idle: the cable moves", f"{confirmed * 1e3:.2f} mm", "", sizes
        ),
        Row("one wrong sample, running: off the gait", f"{running * 1e3:.2f} mm", "", sizes),
        Row("wrong samples that last, running", f"{max(stops) * 1e3:.0f} ms", "", sizes),
        Row(
            "samples that drift, idle: the cable moves",
            f"{drift * 1e3:.2f} mm",
            "",
            f"{DRIFTS} ticks per cycle",
        ),
        Row(
            "largest lasting offset that is not noticed",
            f"{offset} ticks",
            "",
            f"{_metres(offset) * 1e3:.1f} mm of cable",
        ),
        Row(
            "largest lasting offset of a fin that is not noticed",
            f"{of_fin} ticks",
            "",
            f"{of_fin * 360 / 4096:.0f} degrees",
        ),
    ]


def _stops() -> list[Row]:
    closing = [_stopped_while_closing(moment) for moment in STOPS]
    flips = [_flip_stopped(moment) for moment in FLIPS]
    on_time = _fastest_return(None)
    late = max(_fastest_return(random.Random(seed)) for seed in range(10))
    torques = sum(torque for *_, torque in closing)
    contracted = ", ".join(f"{length * 1e3:.0f}" for _, length, _ in closing)
    return [
        Row(
            "stop during shutdown",
            f"{max(time for time, *_ in closing) * 1e3:.0f} ms",
            "",
            f"torque on afterwards in {torques} of {len(closing)}, contracted by {contracted} mm",
        ),
        Row(
            "emergency stop during a flip of the fins",
            f"{max(time for time, _ in flips) * 1e3:.0f} ms",
            "",
            f"they move on by {max(angle for _, angle in flips):.2f} rad at most",
        ),
        Row("return to rest: fastest cable", f"{on_time * 1e3:.1f} mm/s", "", "mean over 30 ms"),
        Row(
            "return to rest: fastest cable, busy",
            f"{late * 1e3:.1f} mm/s",
            "",
            "mean over 30 ms, worst of 10 seeds",
        ),
    ]


#: registers of the cable servo that another program left, raw
LEFT_OVER: Mapping[str, int] = {
    "profile_acceleration": 5,
    "goal_pwm": 120,
    "position_p_gain": 50,
    "status_return_level": 0,
    "pwm_limit": 120,
    "secondary_id": FIN,
}


def _left_over(name: str, value: int) -> Row:
    """Return a row with what the next driver does about a register."""
    rig = Rig()
    row = rig.cable.model.registers[name]
    data = row.address.to_bytes(2, "little") + row.pack(value)
    rig.virtual.receive(instruction_packet(CABLE, Instruction.WRITE, data), rig.clock.now)
    try:
        rig = rig.restarted_driver()
    except ConfigurationError as error:
        return Row(f"another program left {name} {value}", "rejected", "", str(error))
    stood = _time_to_stand(rig, FAULTS["stop is called"], MOMENTS[1], None)
    return Row(f"another program left {name} {value}", f"{stood * 1e3:.0f} ms", "", "stop")


def run() -> list[Row]:
    """Measure wrong samples, stops, left-over registers, and faults in a gait with a punctual and a late loop."""
    rows = _measured() + _bad_data() + _stops()
    rows += [_left_over(name, value) for name, value in LEFT_OVER.items()]
    for name, deed in FAULTS.items():
        for load in ("idle", "busy"):
            dice = random.Random(1) if load == "busy" else None
            times = [_stopping_time(deed, moment, dice) for moment in MOMENTS]
            rows.append(
                Row(
                    f"{name}, {load}",
                    f"{max(times) * 1e3:.0f} ms",
                    "",
                    f"worst of {len(times)} moments of a gait, median {statistics.median(times) * 1e3:.0f} ms",
                )
            )
    return rows
