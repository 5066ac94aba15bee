# SPDX-License-Identifier: Apache-2.0
"""Quality of service of a recording: adapted to the publishers, and described as rosbag2 does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from worm_model.bags.formats.bag_metadata import qos_profile


def subscription_qos(offered: Sequence[QoSProfile], depth: int) -> QoSProfile:
    """Return the strictest quality of service that is compatible with every publisher.

    A best-effort publisher does not connect to a reliable subscription, nor a volatile one to a transient-local
    subscription. A volatile subscription would miss latched messages.

    Args:
        offered: profiles of the present publishers.
        depth: messages stored between two polls of the subscription.
    """
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def describe(publishers: Sequence[TopicEndpointInfo]) -> tuple[Mapping[str, Any], ...]:
    """Return the different profiles that a topic's publishers offer, for metadata.yaml."""
    profiles: list[Mapping[str, Any]] = []
    for publisher in publishers:
        qos = publisher.qos_profile
        profile = qos_profile(
            history=qos.history.short_key,
            depth=qos.depth,
            reliability=qos.reliability.short_key,
            durability=qos.durability.short_key,
            liveliness=qos.liveliness.short_key,
            times=(
                qos.deadline.nanoseconds,
                qos.lifespan.nanoseconds,
                qos.liveliness_lease_duration.nanoseconds,
            ),
        )
        if profile not in profiles:
            profiles.append(profile)
    return tuple(profiles)
