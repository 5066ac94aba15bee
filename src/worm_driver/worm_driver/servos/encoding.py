# SPDX-License-Identifier: Apache-2.0
"""Conversions between the bytes of a register, its raw integer, and its value in the unit of the control table.

A signed register is in two's complement. In the package ``servos``, only this module decodes it.
"""

import math

from worm_driver.servos.registers import Register


def pack(register: Register, raw: int) -> bytes:
    """Return the little-endian bytes of a raw value.

    Raises:
        ValueError: The value does not fit the register.
    """
    try:
        return raw.to_bytes(register.size, "little", signed=register.signed)
    except OverflowError:
        raise ValueError(f"{raw} does not fit {register.name} ({register.size} bytes)") from None


def unpack(register: Register, data: bytes) -> int:
    """Return the raw value of little-endian bytes, with its sign.

    Raises:
        ValueError: The number of bytes is not the register's size.
    """
    if len(data) != register.size:
        raise ValueError(f"{register.name} has {register.size} bytes, not {len(data)}")
    return int.from_bytes(data, "little", signed=register.signed)


def unpack_from(register: Register, block: bytes, start: int) -> int:
    """Return the raw value of a register in a block of the control table that begins at address ``start``.

    Raises:
        ValueError: The block does not contain the whole register.
    """
    offset = register.address - start
    if offset < 0:
        raise ValueError(f"{register.name} begins before the block")
    return unpack(register, block[offset : register.end - start])


def to_raw(register: Register, value: float) -> int:
    """Return the raw value that is nearest to a value in the register's unit.

    Raises:
        ValueError: The value is not finite, or does not fit the register.
    """
    if not math.isfinite(value):
        raise ValueError(f"{register.name} cannot be {value}")
    raw = round(value / register.scale)
    pack(register, raw)
    return raw


def from_raw(register: Register, raw: int) -> float:
    """Return the value in the register's unit."""
    return raw * register.scale
