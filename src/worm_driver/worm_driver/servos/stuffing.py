# SPDX-License-Identifier: Apache-2.0
"""Byte stuffing of Dynamixel Protocol 2.0 (e-manual, Protocol 2.0, "Byte stuffing").

The SDK 4.1.0 computes a stuffed packet and then sends the unstuffed one. It removes stuffing while it overwrites bytes
that it still reads. The functions of this module replace both in servo_bus.
"""

_HEADER = b"\xff\xff\xfd"


def stuff(body: bytes) -> bytes:
    """Insert FD after every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER, _HEADER + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Remove the FD that follows every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER + b"\xfd", _HEADER)
