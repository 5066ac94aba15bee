# SPDX-License-Identifier: Apache-2.0
"""Byte stuffing of Dynamixel Protocol 2.0 (e-manual, Protocol 2.0, "Byte stuffing").

The SDK 4.1.0 computes a stuffed packet and then sends the unstuffed one, and takes stuffing out while it overwrites
the bytes that it still looks at. Both are done right here, and servo_bus puts them in the SDK's place.
"""

_HEADER = b"\xff\xff\xfd"


def stuff(body: bytes) -> bytes:
    """Inserts FD after every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER, _HEADER + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Takes the FD out that follows every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER + b"\xfd", _HEADER)
