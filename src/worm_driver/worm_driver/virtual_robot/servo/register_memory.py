# SPDX-License-Identifier: Apache-2.0
"""Register memory of one virtual servo: raw values by name, bytes by address, write rules."""

from collections.abc import Mapping

from worm_driver.servos.registers import (
    EXTENDED_POSITION_LIMIT,
    EXTENDED_POSITION_MODE,
    POSITION_MODE,
)
from worm_driver.virtual_robot.servo import control_table
from worm_driver.virtual_robot.servo.control_table import VirtualRegister
from worm_driver.virtual_robot.wire.packet import Error

_LIMITED_BY = {
    "goal_pwm": "pwm_limit",
    "goal_current": "current_limit",
    "goal_velocity": "velocity_limit",
}

#: Operating modes in which the shaft turns beyond one turn.
_TURNING = (EXTENDED_POSITION_MODE, control_table.CURRENT_POSITION_MODE)


class RegisterError(Exception):
    """Access that a servo rejects. ``number`` is the error number of the status packet."""

    def __init__(self, number: Error) -> None:
        super().__init__(number.name)
        self.number = number


class RegisterMemory:
    """Control table of a servo with its present values."""

    def __init__(self, model: control_table.VirtualServoModel, settings: Mapping[str, int]) -> None:
        """Create the memory. ``settings`` are raw EEPROM values that differ from the factory values, by name."""
        self._model, self._rows = model, model.registers
        self._by_address = {row.address: row for row in self._rows.values()}
        self._places = {
            name: (slice(row.address, row.address + row.size), row.size, row.signed)
            for name, row in self._rows.items()
        }
        self._bytes = bytearray(control_table.TABLE_END)
        initial = {name: row.initial for name, row in self._rows.items()}
        for name, value in {**initial, **settings}.items():
            self[name] = value

    def __getitem__(self, name: str) -> int:
        place, _, signed = self._places[name]
        return int.from_bytes(self._bytes[place], "little", signed=signed)

    def __setitem__(self, name: str, value: int) -> None:
        place, size, signed = self._places[name]
        self._bytes[place] = value.to_bytes(size, "little", signed=signed)

    def __contains__(self, name: str) -> bool:
        return name in self._rows

    def power_up(self) -> None:
        """Reset the RAM to its values after power-up; the EEPROM is unchanged."""
        for row in self._rows.values():
            if row.address >= control_table.EEPROM_END:
                self[row.name] = row.initial
        self.reset_goals()

    def reset_mode_dependents(self) -> None:
        """Reset gains, profile, and the goals of PWM, current and velocity, as a change of the operating mode does."""
        for name, row in self._rows.items():
            if name.endswith("_gain") or name.startswith("profile_"):
                self[name] = row.initial
        self.reset_goals()

    def reset_goals(self) -> None:
        """Set goal PWM and goal current to their limits, and goal velocity to zero."""
        self["goal_pwm"] = self["pwm_limit"]
        if "goal_current" in self:
            self["goal_current"] = self["current_limit"]
        self["goal_velocity"] = 0

    def read(self, address: int, length: int) -> bytes:
        """Return the bytes of a range, with 0 in the gaps between registers. Raises RegisterError beyond the table."""
        if address + length > control_table.TABLE_END:
            raise RegisterError(Error.ACCESS)
        return bytes(self._bytes[address : address + length])

    def check_write(self, address: int, data: bytes) -> list[tuple[VirtualRegister, int]]:
        """Return the registers that a write would set, with their new raw values, without writing.

        Raises RegisterError if the servo rejects the write.
        """
        changes = []
        while data:
            row = self._by_address.get(address)
            if row is None or not row.writable:
                raise RegisterError(Error.ACCESS)
            if len(data) < row.size:
                raise RegisterError(Error.DATA_LENGTH)
            value = row.unpack(data[: row.size])
            self._check_value(row, value)
            changes.append((row, value))
            address, data = address + row.size, data[row.size :]
        if not changes:
            raise RegisterError(Error.DATA_LENGTH)
        return changes

    def _check_value(self, row: VirtualRegister, value: int) -> None:
        """Raise RegisterError if the servo rejects a value in its present state."""
        watchdog, mode = self["bus_watchdog"], self["operating_mode"]
        if row.address < control_table.EEPROM_END and self["torque_enable"]:
            raise RegisterError(Error.ACCESS)
        if row.name in control_table.GOALS and watchdog < 0:
            raise RegisterError(Error.DATA_RANGE)
        low, high, error = row.low, row.high, Error.DATA_RANGE
        if row.name in _LIMITED_BY:
            high, error = self[_LIMITED_BY[row.name]], Error.DATA_LIMIT
            low = -high
        elif row.name == "goal_position" and mode == POSITION_MODE:
            low, high = self["min_position_limit"], self["max_position_limit"]
            error = Error.DATA_LIMIT
        elif row.name == "goal_position" and mode in _TURNING:
            low, high = -EXTENDED_POSITION_LIMIT, EXTENDED_POSITION_LIMIT
        elif row.name == "bus_watchdog":
            low, high = 0, 0 if watchdog < 0 else row.high
        if not low <= value <= high or (
            row.name == "operating_mode" and value not in self._model.modes
        ):
            raise RegisterError(error)
