# SPDX-License-Identifier: Apache-2.0
"""Control of the robot as a lease: one client has control, and loses it when its requests stop."""

from worm_driver.control.heartbeat import HeartbeatMonitor

#: longest lease, s. It limits the time for which a client that has crashed keeps control
MAX_LEASE = 600.0


class ControlLease:
    """Record of the client that has control, and of the client that requests control from it.

    Not thread-safe. Times are monotonic, in s.

    Attributes:
        holder: name of the client that has control; empty: none.
        requester: name of the client that requests control from the holder; empty: none.
    """

    def __init__(self) -> None:
        self.holder = ""
        self.requester = ""
        self._owners: dict[str, HeartbeatMonitor] = {}

    def request(self, client: str, lease: float, now: float) -> None:
        """Give control to a client if no client has it. Otherwise renew the client's lease or store its request.

        Only the first requester is stored, until it obtains control, withdraws its request or falls silent.

        Args:
            client: name of the client; an empty name changes nothing.
            lease: time without a request after which the client loses control or its request, s. The client's first
                request sets this time; later ones do not change it.
            now: present time, s.

        Raises:
            ValueError: The lease is 0 or less, or more than MAX_LEASE.
        """
        if not 0.0 < lease <= MAX_LEASE:
            raise ValueError(
                f"lease_s is {lease:g}. Use a lease above 0 s and of at most {MAX_LEASE:g} s."
            )
        if not client:
            return
        if not self.holder:
            self.holder = client
        elif client != self.holder and not self.requester:
            self.requester = client
        if client in (self.holder, self.requester):
            self._owners.setdefault(client, HeartbeatMonitor(lease, now)).record()

    def hand_over(self, client: str) -> None:
        """Give control to the requester, if there is one and ``client`` has control."""
        if client == self.holder and self.requester:
            self.release(client)

    def release(self, client: str) -> None:
        """End the control or the request of a client. If the client had control, the requester obtains it."""
        if not client:
            return
        self._owners.pop(client, None)
        if client == self.requester:
            self.requester = ""
        elif client == self.holder:
            self.holder, self.requester = self.requester, ""

    def expire(self, now: float) -> None:
        """Release the clients that have been silent for longer than their lease. Call this every `heartbeat.PERIOD`."""
        for client in [name for name, owner in self._owners.items() if owner.is_silent(now)]:
            self.release(client)
