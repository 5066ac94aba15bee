# SPDX-License-Identifier: Apache-2.0
"""Exclusive use of a namespace: at most one driver and one robot per namespace and ROS domain on this computer.

A claim is a listening socket in Linux's abstract socket namespace. The kernel allows one socket per name, for all
users, and removes the socket when its process ends, for whatever reason. So a claim is never stale. Other computers do
not see a claim, nor do containers that have a network of their own. To find drivers on other computers, the driver
searches the ROS graph.
"""

from __future__ import annotations

import ctypes
import errno
import hashlib
import socket
import struct
from collections.abc import Mapping

DRIVER = "driver"
ROBOT = "virtual robot or player"
#: service that identifies a driver: every driver node has it, whatever the node is called, and no other node has it
DRIVER_SERVICE = "run_gait/_action/send_goal"
#: s, time after which a killed driver is no longer in the ROS graph. DDS removes a participant 20 s after its last sign
#: of life; the other 5 s are reserve
ANNOUNCED_S = 25.0
_strtoul = ctypes.CDLL(None).strtoul
_strtoul.restype = ctypes.c_ulong
#: largest number of looks at a claim (`holder`), which stay in its queue until it ends; the kernel's own limit
_LOOKS = 4096
_CREDENTIALS = struct.Struct("3i")  # pid, uid, gid: struct ucred, unix(7)


class ClaimedError(RuntimeError):
    """Another process has the claim. The message contains the process id if it is known."""


def claim(role: str, namespace: str, domain: int) -> socket.socket:
    """Claim a role in a namespace of a ROS domain until the returned socket is closed or the process ends.

    Raises:
        ClaimedError: Another process has the claim.
        OSError: The socket cannot be created for another reason.
    """
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.bind(_address(role, namespace, domain))
        made.listen(_LOOKS)
    except OSError as error:
        made.close()
        if error.errno != errno.EADDRINUSE:
            raise
        process = holder(role, namespace, domain) or "unknown"
        raise ClaimedError(
            f"/{namespace.strip('/')} has a {role} already, process {process} on this computer, in ROS "
            f"domain {domain}. End it first, or use another namespace or ROS_DOMAIN_ID"
        ) from None
    return made


def claim_robot(namespace: str, domain: int) -> socket.socket:
    """Claim a namespace for a virtual robot, or for a player that replaces a robot. It must not have a driver yet.

    The driver of a virtual robot starts later, as it waits for the robot's devices.

    Raises:
        ClaimedError: A virtual robot, a player or a driver runs in the namespace.
    """
    made = claim(ROBOT, namespace, domain)
    try:
        claim(DRIVER, namespace, domain).close()
    except ClaimedError:
        made.close()
        raise
    return made


def domain_of(environment: Mapping[str, str]) -> int:
    """Return the ROS domain that an environment selects with ROS_DOMAIN_ID.

    The text is read with strtoul, as ROS does: 0x5 is 5. Return 0 if the variable is missing or no number.
    """
    return int(_strtoul(environment.get("ROS_DOMAIN_ID", "").encode(), None, 0))


def _address(role: str, namespace: str, domain: int) -> bytes:
    """Return the address of the socket. It contains a hash, because the length of an address is limited."""
    digest = hashlib.sha256(namespace.strip("/").encode()).hexdigest()[:32]
    return f"\0worm {role} {domain} {digest}".encode()


def holder(role: str, namespace: str, domain: int) -> int:
    """Return the id of the process that has a claim; 0 if no process has it or the id is unknown.

    The connection does not block, although the other process never accepts it.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.setblocking(False)
        try:
            client.connect(_address(role, namespace, domain))
            credentials = client.getsockopt(
                socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size
            )
        except OSError:  # The process has just ended, or its queue of connections is full.
            return 0
    return int(_CREDENTIALS.unpack(credentials)[0])
