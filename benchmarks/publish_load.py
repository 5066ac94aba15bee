# SPDX-License-Identifier: Apache-2.0
"""Publisher of numbered messages at a fixed rate: ``python -m benchmarks.publish_load RATE BYTES SECONDS``.

Each of ten topics has its own numbers 0, 1, 2, … in the first eight bytes of a UInt8MultiArray. The other bytes are
random, so that they cannot be compressed. The process waits for a subscriber of every topic, publishes, waits for the
acknowledgements, and prints the number of messages.
"""

from __future__ import annotations

import os
import struct
import sys
import time

import rclpy
from rclpy.duration import Duration
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt8MultiArray

TOPICS = 10
NUMBER_OFFSET = 16  # of the first data byte in the CDR: header, empty layout, offset, length


def main() -> None:
    """Publish."""
    rate, size, seconds = float(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("load")
    # What a publisher keeps for retransmission; at this rate ten samples are gone in 20 ms.
    qos = QoSProfile(depth=1000)
    publishers = [node.create_publisher(UInt8MultiArray, f"load_{i}", qos) for i in range(TOPICS)]
    while any(publisher.get_subscription_count() == 0 for publisher in publishers):
        time.sleep(0.05)
    head = serialize_message(UInt8MultiArray(data=bytes(size)))[:NUMBER_OFFSET]
    start, sent = time.monotonic(), 0
    while (elapsed := time.monotonic() - start) < seconds:
        while sent < elapsed * rate:
            number = struct.pack("<Q", sent // TOPICS)
            publishers[sent % TOPICS].publish(head + number + os.urandom(size - len(number)))
            sent += 1
        time.sleep(0.002)
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=10))
    sys.stdout.write(f"sent {sent}\n")
    sys.stdout.flush()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
