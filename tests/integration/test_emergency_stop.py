# SPDX-License-Identifier: Apache-2.0
"""Publishers of the emergency stop over real DDS:

whose false permits a reset, and which of them trigger a stop by their end.
"""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from harness import LATCHED, Probe
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.errors import DriverError
from worm_driver.nodes.stop_services import StopServices
from worm_msgs.msg import Heartbeat

TOPIC = "emergency_stop"
QUALITIES = (
    LATCHED,
    QoSProfile(depth=1),
    QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT),
)


class Stops:
    """The stop services of a driver that has opened nothing, and clients with several publishers."""

    def __init__(
        self,
        probe: Probe,
        folder: Path,
        on_heartbeat: Callable[[Heartbeat], None] = lambda _: None,
    ) -> None:
        self.probe = probe
        self.latch = EmergencyLatch(folder)
        self.latch.adopt(["stop"])
        self.services = StopServices(
            probe.node,
            _closed,
            self.latch,
            lambda: None,
            on_heartbeat,
            lambda: probe.node.get_clock().now().to_msg(),
        )

    def button(self, qos: QoSProfile) -> Publisher:
        return self.probe.node.create_publisher(Bool, TOPIC, qos)

    def publish(self, button: Publisher, value: bool) -> None:
        """Publish a value to every subscription that this quality matches."""
        matching = 1 + (button.qos_profile.reliability == ReliabilityPolicy.RELIABLE)
        matching += button.qos_profile.durability == LATCHED.durability
        self.probe.wait_for(lambda: button.get_subscription_count() == matching, "driver")
        button.publish(Bool(data=value))

    def press(self, button: Publisher) -> None:
        self.publish(button, True)
        self.probe.wait_for(lambda: self.latch.on, "emergency stop")

    def reset(self) -> Trigger.Response:
        return self.probe.call(Trigger, "reset_emergency_stop", Trigger.Request())

    def reset_when_permitted(self) -> str:
        """Reset as soon as the published messages have arrived; topic and service are not ordered."""

        def permitted() -> str | None:
            answer = self.reset()
            return answer.message if answer.success else None

        return str(self.probe.wait_for(permitted, "reset"))


def _closed() -> None:
    raise DriverError("nothing is open")


@pytest.fixture
def stops(probe: Probe, tmp_path: Path) -> Iterator[Stops]:
    made = Stops(probe, tmp_path)
    yield made
    made.services.close()


@pytest.mark.parametrize("qos", QUALITIES, ids=["latched", "reliable", "best_effort"])
def test_only_a_reset_clears_and_not_before_the_publisher_took_its_true_back(
    stops: Stops, qos: QoSProfile
):
    button = stops.button(qos)
    stops.press(button)
    answer = stops.reset()
    assert not answer.success
    assert "/worm/probe" in answer.message
    stops.publish(button, False)
    stops.reset_when_permitted()
    assert not stops.latch.on


def test_a_false_of_any_other_publisher_neither_clears_nor_permits(stops: Stops):
    button, *others = (stops.button(qos) for qos in QUALITIES)
    stops.press(button)
    for other in others:
        stops.publish(other, False)
    assert not stops.reset().success
    assert stops.latch.on
    stops.press(others[0])
    stops.publish(button, False)
    stops.publish(button, False)
    assert not stops.reset().success
    stops.publish(others[0], False)
    stops.reset_when_permitted()


def test_a_publisher_that_ended_with_true_leaves_the_stop_on_and_a_reset_is_possible(stops: Stops):
    button, healthy = stops.button(LATCHED), stops.button(LATCHED)
    stops.publish(healthy, False)
    stops.press(button)
    stops.probe.node.destroy_publisher(button)
    topic = stops.probe.node.resolve_topic_name(TOPIC)
    stops.probe.wait_for(lambda: stops.probe.node.count_publishers(topic) == 1, "end of the button")
    assert stops.latch.on
    assert "1 of its publishers ended" in stops.reset_when_permitted()
    assert not stops.latch.on
    stops.press(stops.button(LATCHED))  # the publisher comes back, still pressed
    assert not stops.reset().success


def test_a_true_from_before_the_driver_latches_and_blocks_the_reset(probe: Probe, tmp_path: Path):
    button = probe.node.create_publisher(Bool, TOPIC, LATCHED)
    button.publish(Bool(data=True))
    stops = Stops(probe, tmp_path)
    try:
        probe.wait_for(lambda: stops.latch.on, "emergency stop")
        assert not stops.reset().success
    finally:
        stops.services.close()


def test_a_reset_without_a_stop_succeeds(stops: Stops):
    assert stops.reset().success


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
