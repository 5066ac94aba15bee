# SPDX-License-Identifier: Apache-2.0
"""Keeps a namespace to one driver: two would both execute what is sent to one of them."""

import time
from collections.abc import Callable

from rclpy.node import Node

from worm_driver.errors import ConfigurationError, DriverError
from worm_msgs.claim import DRIVER, ClaimedError, claim

#: only a driver serves it
_SERVICE = "run_gait/_action/send_goal"
#: s, in which a driver on the network is usually discovered; one that is discovered later still stops every start
_DISCOVERY = 5.0
#: s between two looks
_LOOK = 0.05
#: s, for which DDS announces a driver that was killed
_LEASE = 25.0


class SoleDriver:
    """The claim of a namespace: exact on this computer, by the ROS graph on the network.

    Args:
        node: the driver's.
        on_network: whether drivers of other computers may share the namespace.

    Attributes:
        problem: why nothing may start, as another driver was discovered; empty when there is none.

    Raises:
        ConfigurationError: another driver of this computer is in the namespace.
    """

    def __init__(self, node: Node, *, on_network: bool):
        self._node, self._on_network = node, on_network
        try:
            self._claim = claim(DRIVER, node.get_namespace(), node.context.get_domain_id())
        except ClaimedError as error:
            raise ConfigurationError(str(error)) from None
        self.problem = ""

    def close(self) -> None:
        """Give the claim up."""
        self._claim.close()

    def wait(self, ended: Callable[[], bool]) -> None:
        """Wait until no other driver is announced on the network; returns at once where there is none to look for.

        Raises:
            ConfigurationError: there is another driver.
        """
        start = time.monotonic()
        while self._on_network and not ended():
            self.look()
            elapsed = time.monotonic() - start
            if not self.problem and elapsed > _DISCOVERY:
                return
            if elapsed > _LEASE:
                raise ConfigurationError(self.problem)
            time.sleep(_LOOK)

    def look(self) -> None:
        """Look for other drivers; one that comes or goes is logged."""
        if not self._on_network:
            return
        count = self._node.count_services(self._node.resolve_service_name(_SERVICE))
        before, self.problem = self.problem, ""
        if count > 1:
            self.problem = (
                f"{self._node.get_namespace()} has {count} drivers on the network: nothing starts before all but one "
                "have ended, or have another namespace or ROS_DOMAIN_ID"
            )
        if self.problem != before:
            self._node.get_logger().error(self.problem or "the other driver is gone")

    def require(self) -> None:
        """Raise DriverError where there is another driver."""
        self.look()
        if self.problem:
            raise DriverError(self.problem)
