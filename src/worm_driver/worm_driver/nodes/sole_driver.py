# SPDX-License-Identifier: Apache-2.0
"""Check that a namespace has only one driver, because two drivers would both execute each goal."""

import time
from collections.abc import Callable

from rclpy.node import Node

from worm_driver.driver_errors import ConfigurationError, DriverError
from worm_msgs.claim import ANNOUNCED_S, DRIVER, DRIVER_SERVICE, ClaimedError, claim

#: s, usual time to discover a driver on the network. A driver that is discovered later still prevents torque and runs
#: from starting.
_DISCOVERY = 5.0
#: s, period of the checks
_PERIOD = 0.05


class SoleDriver:
    """Check of a namespace for other drivers: by a claim on this computer, by the ROS graph on the network.

    Args:
        node: node of the driver.
        on_network: True if other computers can reach the driver.

    Attributes:
        problem: reason why neither torque nor a run may start, if another driver was discovered; otherwise empty.
    """

    def __init__(self, node: Node, *, on_network: bool):
        self._node, self._on_network = node, on_network
        try:
            self._claim = claim(DRIVER, node.get_namespace(), node.context.get_domain_id())
        except ClaimedError as error:
            raise ConfigurationError(str(error)) from None
        self.problem = ""

    def close(self) -> None:
        """Release the claim."""
        self._claim.close()

    def wait(self, ended: Callable[[], bool]) -> None:
        """Wait until no other driver is announced on the network, at least for the usual time of discovery.

        Return at once if no other computer can reach the driver. Return early when ``ended`` returns True.
        """
        start = time.monotonic()
        while self._on_network and not ended():
            self.check()
            elapsed = time.monotonic() - start
            if not self.problem and elapsed > _DISCOVERY:
                return
            if elapsed > ANNOUNCED_S:
                raise ConfigurationError(self.problem)
            time.sleep(_PERIOD)

    def check(self) -> None:
        """Look for other drivers, and log changes."""
        if not self._on_network:
            return
        count = self._node.count_services(self._node.resolve_service_name(DRIVER_SERVICE))
        before, self.problem = self.problem, ""
        if count > 1:
            self.problem = (
                f"{self._node.get_namespace()} has {count} drivers on the network: nothing starts. End all but one, or "
                "give them other namespaces or another ROS_DOMAIN_ID"
            )
        if self.problem != before:
            self._node.get_logger().error(self.problem or "the other driver has ended")

    def require(self) -> None:
        """Raise DriverError if there is another driver."""
        self.check()
        if self.problem:
            raise DriverError(self.problem)
