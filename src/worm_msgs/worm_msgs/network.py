# SPDX-License-Identifier: Apache-2.0
"""Who can hear a process with ROS: this machine alone, unless somebody decided otherwise under a name.

``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` is no access control: the ports are bound on every address all the same, and
whoever names this machine as a static peer finds its topics, services and actions. So the middleware itself is bound to
the loopback interface here, each in its own way.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path

#: set to 1: this process may be heard on the network
DECISION = "WORM_NETWORK"

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_FAST_DDS = Path(__file__).with_name("fastdds_loopback.xml")
_CYCLONE_DDS = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/>'
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)

#: what binds a middleware to the loopback interface, by the beginning of its name: set before its first participant
_BINDINGS: Mapping[str, Mapping[str, str]] = {
    "rmw_fastrtps": {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(_FAST_DDS),
        "FASTDDS_DEFAULT_PROFILES_FILE": str(_FAST_DDS),
        "SKIP_DEFAULT_XML": "1",  # else a file of the working folder may open it again
        # The profile says it all; for LOCALHOST the rmw adds a transport of its own, with sockets on every address.
        _RANGE: "SYSTEM_DEFAULT",
    },
    "rmw_cyclonedds": {"CYCLONEDDS_URI": _CYCLONE_DDS, _RANGE: "LOCALHOST"},
}
#: the bindings that are somebody's decision for the network when they hold something else
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "CYCLONEDDS_URI")


class NetworkError(Exception):
    """The middleware cannot be kept on this machine, or the variable says nothing that is known."""


@dataclass(frozen=True)
class Reach:
    """Who can hear a process.

    Attributes:
        opened_by: the variable, with its value, that lets it onto the network; empty: nothing does.
    """

    opened_by: str = ""

    @property
    def is_local(self) -> bool:
        """Whether only programs of this machine can talk to it."""
        return not self.opened_by

    def __str__(self) -> str:
        if self.is_local:
            return "heard on this machine only"
        return (
            f"heard on the network ({self.opened_by}): whoever is on it can move the robot, unless SROS 2 "
            "keeps them out (docs/safety.md)"
        )


def reach(environment: Mapping[str, str], middleware: str) -> Reach:
    """Who can hear a process with this environment on this middleware (an rmw's name), once it is bound.

    Raises:
        NetworkError: nobody decided for the network, and the middleware cannot be kept off it.
    """
    decided = environment.get(DECISION, "")
    if decided not in ("", "0", "1"):
        raise NetworkError(f"{DECISION} is {decided!r}: 1 lets ROS onto the network, 0 does not")
    binding = _binding(middleware)
    ours = any(known.items() <= environment.items() for known in _BINDINGS.values())
    profiles = {name: (binding or {}).get(name) for name in _PROFILES}
    openers = {
        DECISION: decided == "1",
        _RANGE: environment.get(_RANGE) == "SUBNET"
        or (environment.get(_RANGE) == "SYSTEM_DEFAULT" and not ours),
        "ROS_STATIC_PEERS": _leaves_the_machine(environment.get("ROS_STATIC_PEERS", "")),
        "ROS_DISCOVERY_SERVER": _leaves_the_machine(environment.get("ROS_DISCOVERY_SERVER", "")),
        **{
            name: value is not None and environment.get(name, value) not in ("", value)
            for name, value in profiles.items()
        },
    }
    opener = next((name for name, opens in openers.items() if opens), "")
    if not opener and binding is None:
        raise NetworkError(
            f"{middleware} cannot be kept on this machine by this software, which can do that with Fast DDS and "
            f"Cyclone DDS: choose one of them (RMW_IMPLEMENTATION), or decide for the network ({DECISION}=1)"
        )
    return Reach(f"{opener}={environment[opener]}" if opener else "")


def bind(environment: MutableMapping[str, str], middleware: str) -> Reach:
    """Sets what keeps a process on this machine, unless it is to be heard on the network; returns who can hear it.

    To be called before the first context of ROS. Started processes inherit the environment, and the decision with it.

    Raises:
        NetworkError: as reach.
    """
    current, binding = reach(environment, middleware), _binding(middleware) or {}
    if current.is_local:
        silent = environment.get(_RANGE) == "OFF"  # hears nobody at all, and shall not
        environment.update({n: v for n, v in binding.items() if n != _RANGE or not silent})
        return current
    inherited = {n: v for n, v in binding.items() if n != _RANGE}
    if (
        binding and inherited.items() <= environment.items()
    ):  # from a process that was kept on this machine
        for name in inherited:
            del environment[name]
        if environment.get(_RANGE) == binding[_RANGE]:
            del environment[_RANGE]
    if environment.get(DECISION) == "1" and environment.get(_RANGE, "LOCALHOST") == "LOCALHOST":
        environment[_RANGE] = "SUBNET"
    return current


def _binding(middleware: str) -> Mapping[str, str] | None:
    return next((b for name, b in _BINDINGS.items() if middleware.startswith(name)), None)


def _leaves_the_machine(peers: str) -> bool:
    """Whether a list of addresses, as ROS's variables have it, names one beyond this machine."""
    hosts = (peer.strip().rsplit(":", 1)[0] for peer in peers.split(";") if peer.strip())
    return not all(host == "localhost" or _is_loopback(host) for host in hosts)


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
