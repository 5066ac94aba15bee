# SPDX-License-Identifier: Apache-2.0
"""The emergency stop over real DDS: any true latches, and only a reset clears, not while the latest message is true."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import LATCHED, Probe
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.driver_errors import DriverError
from worm_driver.nodes.stop_services import StopServices
from worm_msgs.msg import Heartbeat

TOPIC = "emergency_stop"
QUALITIES = (
    LATCHED,
    QoSProfile(depth=1),
    QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
)


class Stops:
    """The stop services of a driver that has opened nothing, and its clients."""

    def __init__(
        self, probe: Probe, folder: Path, on_heartbeat: Callable[[Heartbeat], None] = lambda _: None
    ) -> None:
        self.probe = probe
        self.latch = EmergencyLatch(folder)
        self.latch.adopt(["stop"])
        self.services = StopServices(probe.node, _closed, self.latch, lambda: None, on_heartbeat)

    def button(self, qos: QoSProfile) -> Publisher:
        """Return a publisher that all matching subscriptions have discovered."""
        button = self.probe.node.create_publisher(Bool, TOPIC, qos)
        matching = 1 + (qos.reliability == ReliabilityPolicy.RELIABLE)
        matching += qos.durability == LATCHED.durability
        self.probe.wait_for(lambda: button.get_subscription_count() == matching, "driver")
        return button

    def press(self, button: Publisher) -> None:
        button.publish(Bool(data=True))
        self.probe.wait_for(lambda: self.latch.on, "emergency stop")

    def reset(self) -> bool:
        return self.probe.call(Trigger, "reset_emergency_stop", Trigger.Request()).success


def _closed() -> None:
    raise DriverError("nothing is open")


@pytest.fixture
def stops(probe: Probe, tmp_path: Path) -> Iterator[Stops]:
    made = Stops(probe, tmp_path)
    yield made
    made.services.close()


@pytest.mark.parametrize("qos", QUALITIES, ids=["latched", "reliable", "best_effort"])
def test_a_pressed_button_latches_and_only_a_reset_after_its_release_clears(
    stops: Stops, qos: QoSProfile
):
    assert stops.reset()  # without a stop
    button = stops.button(qos)
    stops.press(button)
    assert not stops.reset()
    assert stops.latch.on
    button.publish(Bool(data=False))
    stops.probe.wait_for(stops.reset, "reset")
    assert not stops.latch.on
    stops.press(button)


def test_a_true_from_before_the_driver_latches_and_blocks_the_reset(probe: Probe, tmp_path: Path):
    button = probe.node.create_publisher(Bool, TOPIC, LATCHED)
    button.publish(Bool(data=True))
    stops = Stops(probe, tmp_path)
    try:
        probe.wait_for(lambda: stops.latch.on, "emergency stop")
        assert not stops.reset()
    finally:
        stops.services.close()


def test_an_error_in_one_request_does_not_end_the_service_of_stops(probe: Probe, tmp_path: Path):
    failed = []

    def fail(beat: Heartbeat) -> None:
        failed.append(beat)
        raise RuntimeError("a defect")

    stops = Stops(probe, tmp_path, fail)
    heart = probe.node.create_publisher(Heartbeat, "heartbeat", 1)
    probe.wait_for(lambda: heart.get_subscription_count() == 1, "driver")
    heart.publish(Heartbeat())
    probe.wait_for(lambda: failed, "heartbeat")
    stops.press(stops.button(LATCHED))
    stops.services.close()
