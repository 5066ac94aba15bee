# SPDX-License-Identifier: Apache-2.0
"""Bytes, raw integers and SI values of a register.

The SDK hands every value back unsigned; two's complement is undone here, and nowhere else.
"""

import math

from worm_driver.servos.registers import Register


def pack(register: Register, raw: int) -> bytes:
    """Raw value to the register's little-endian bytes.

    Raises ValueError: the value does not fit the register.
    """
    try:
        return raw.to_bytes(register.size, "little", signed=register.signed)
    except OverflowError:
        raise ValueError(f"{raw} does not fit {register.name} ({register.size} bytes)") from None


def unpack(register: Register, data: bytes) -> int:
    """The register's little-endian bytes to its raw value, sign and all.

    Raises ValueError: the number of bytes is not the register's size.
    """
    if len(data) != register.size:
        raise ValueError(f"{register.name} has {register.size} bytes, not {len(data)}")
    return int.from_bytes(data, "little", signed=register.signed)


def unpack_from(register: Register, block: bytes, start: int) -> int:
    """A register's raw value out of a block of the control table that begins at address ``start``."""
    return unpack(register, block[register.address - start : register.end - start])


def to_raw(register: Register, value: float) -> int:
    """SI value to the nearest raw value.

    Raises ValueError: the value is not finite, or does not fit the register.
    """
    if not math.isfinite(value):
        raise ValueError(f"{register.name} cannot be {value}")
    raw = round(value / register.scale)
    pack(register, raw)
    return raw


def from_raw(register: Register, raw: int) -> float:
    """Raw value to the register's unit."""
    return raw * register.scale
