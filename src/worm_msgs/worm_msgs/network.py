# SPDX-License-Identifier: Apache-2.0
"""Network access of a process with ROS: this machine only, unless an environment variable opens the network.

``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` is no access control. A host that names this machine as a static peer still
finds the topics, services and actions of this machine. So this module restricts each supported middleware to the
loopback interface, with the middleware's own settings. To bind a process means to restrict it in this way.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass
from pathlib import Path

from worm_msgs.claim import domain_of

#: Environment variable. Its value 1 opens the network: other hosts can reach this process. Its value 0 keeps the
#: network closed, whatever other variables say.
DECISION = "WORM_NETWORK"

_RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
_LAST_DOMAIN = 232  # the ports of a larger domain are above 65535
_FAST_DDS = Path(__file__).with_name("fastdds_loopback.xml")
_CYCLONE_DDS = (
    '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/>'
    "</Interfaces><AllowMulticast>false</AllowMulticast></General><Discovery>"
    "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>100</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)

#: Environment variables that bind a middleware to the loopback interface, by the prefix of the middleware's rmw name.
_BINDINGS: Mapping[str, Mapping[str, str]] = {
    "rmw_fastrtps": {
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(_FAST_DDS),
        "FASTDDS_DEFAULT_PROFILES_FILE": str(_FAST_DDS),
        "SKIP_DEFAULT_XML": "1",  # Otherwise a file in the working folder could open the network again.
        # The profile defines all transports. For LOCALHOST the rmw would add a transport with sockets on every address.
        _RANGE: "SYSTEM_DEFAULT",
    },
    "rmw_cyclonedds": {"CYCLONEDDS_URI": _CYCLONE_DDS, _RANGE: "LOCALHOST"},
}
#: Variables that select a middleware profile. If the environment sets such a variable of the middleware in use to
#: another value than `_BINDINGS`, the user's own profile applies, and the network counts as open. An empty value counts
#: as unset.
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "CYCLONEDDS_URI")


class NetworkError(Exception):
    """The middleware cannot be bound to this machine, or WORM_NETWORK has an unknown value."""


@dataclass(frozen=True)
class Reach:
    """Network access of other hosts to a process.

    Attributes:
        opened_by: environment variable and value that open the network; empty if the network is closed.
    """

    opened_by: str = ""

    @property
    def is_local(self) -> bool:
        """True if only programs on this machine can reach the process."""
        return not self.opened_by

    def __str__(self) -> str:
        if self.is_local:
            return "reachable from this machine only"
        return (
            f"reachable from the network ({self.opened_by}): every host on it can move the robot, unless SROS 2 "
            "restricts access (docs/safety.md)"
        )


def reach(environment: Mapping[str, str], middleware: str) -> Reach:
    """Return the access of other hosts to a process after a call of `bind` with this environment.

    ``middleware`` is the name of the rmw.
    """
    decided = environment.get(DECISION, "")
    if decided not in ("", "0", "1"):
        raise NetworkError(
            f"{DECISION} is {decided!r}; set it to 1 to open ROS to the network, or to 0"
        )
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
    opener = "" if decided == "0" else next((name for name, opens in openers.items() if opens), "")
    if not opener and binding is None:
        raise NetworkError(
            f"{middleware} cannot be bound to this machine only; Fast DDS and Cyclone DDS can. Choose one of "
            f"them (RMW_IMPLEMENTATION), or open the network ({DECISION}=1)"
        )
    return Reach(f"{opener}={environment[opener]}" if opener else "")


def bind(environment: MutableMapping[str, str], middleware: str) -> Reach:
    """Bind this process to this machine, unless the environment opens the network.

    The function changes the variables in ``environment``, which child processes inherit. Call it before the first
    context of ROS is created.

    Returns:
        Access of other hosts to this process from then on.
    """
    if domain_of(environment) > _LAST_DOMAIN:  # Fast DDS would print several lines
        raise NetworkError(
            f"ROS_DOMAIN_ID is {environment['ROS_DOMAIN_ID']!r}; use a number from 0 to {_LAST_DOMAIN}"
        )
    current, binding = reach(environment, middleware), _binding(middleware) or {}
    if current.is_local:
        discovers_none = environment.get(_RANGE) == "OFF"
        environment.update({n: v for n, v in binding.items() if n != _RANGE or not discovers_none})
        return current
    inherited = {n: v for n, v in binding.items() if n != _RANGE}
    if binding and inherited.items() <= environment.items():
        # A parent process that was bound to this machine has set these variables. They are removed, so that the
        # middleware opens the network as requested.
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
    """Return True if a list of addresses contains a host other than localhost and the loopback addresses.

    The addresses are separated by semicolons, as in ROS_STATIC_PEERS and ROS_DISCOVERY_SERVER. A port may follow an
    address: ``127.0.0.1:11811``, ``[::1]:11811``.
    """
    addresses = (peer.strip() for peer in peers.split(";") if peer.strip())
    return not all(
        _is_loopback(address) or _is_loopback(address.rsplit(":", 1)[0].strip("[]"))
        for address in addresses
    )


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
