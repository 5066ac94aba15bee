# SPDX-License-Identifier: Apache-2.0
"""Subscription to a Bool whose callback also receives the publisher and the time of sending.

The middleware delivers publisher and time with every message (rmw_message_info_t), but rclpy of Jazzy does not pass the
publisher on. So this module reads the messages of a subscription of rclpy with a function of rcl.
"""

import ctypes
from collections.abc import Callable
from functools import cache

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.waitable import NumberOfEntities, Waitable
from std_msgs.msg import Bool

from worm_msgs.ros_process import PolledGroup

#: Callback with the publisher's identifier, the time of sending (ns) and the value.
OnBool = Callable[[bytes, int, bool], None]

_GID_SIZE = 16  # RMW_GID_STORAGE_SIZE
_OK, _NOTHING = 0, 401  # RCL_RET_OK, RCL_RET_SUBSCRIPTION_TAKE_FAILED


class _Gid(ctypes.Structure):
    """The C type rmw_gid_t."""

    _fields_ = (
        ("implementation_identifier", ctypes.c_char_p),
        ("data", ctypes.c_uint8 * _GID_SIZE),
    )


class _MessageInfo(ctypes.Structure):
    """The C type rmw_message_info_t."""

    _fields_ = (
        ("source_timestamp", ctypes.c_int64),
        ("received_timestamp", ctypes.c_int64),
        ("publication_sequence_number", ctypes.c_uint64),
        ("reception_sequence_number", ctypes.c_uint64),
        ("publisher_gid", _Gid),
        ("from_intra_process", ctypes.c_bool),
    )


@cache
def _rcl_take() -> Callable[..., int]:
    take = ctypes.CDLL("librcl.so").rcl_take  # the library that rclpy has loaded
    take.restype = ctypes.c_int
    take.argtypes = (ctypes.c_void_p,) * 4
    return take


class IdentifiedSubscription(Waitable):
    """Subscription of a node to a topic of std_msgs/Bool. ``callback`` runs in the thread that spins the node."""

    def __init__(self, node: Node, topic: str, qos: QoSProfile, callback: OnBool) -> None:
        super().__init__(MutuallyExclusiveCallbackGroup())
        _rcl_take()  # A library without this function must be detected before the first message.
        self._logger = node.get_logger()
        self._callback = callback
        self._subscription = node.create_subscription(
            Bool, topic, lambda _: None, qos, callback_group=PolledGroup()
        )
        self._index: int | None = None
        node.add_waitable(self)

    def __enter__(self) -> None:
        self._subscription.handle.__enter__()

    def __exit__(self, *exception: object) -> None:
        self._subscription.handle.__exit__(*exception)

    def get_num_entities(self) -> NumberOfEntities:
        """Return one subscription."""
        return NumberOfEntities(num_subs=1)

    def add_to_wait_set(self, wait_set: object) -> None:
        """Add the subscription to rclpy's wait set."""
        self._index = wait_set.add_subscription(self._subscription.handle)  # type: ignore[attr-defined]

    def is_ready(self, wait_set: object) -> bool:
        """Return True if a message waits."""
        return bool(wait_set.is_ready("subscription", self._index))  # type: ignore[attr-defined]

    def take_data(self) -> list[tuple[bytes, int, bool]]:
        """Return all waiting messages."""
        messages = []
        with self._subscription.handle:
            while (message := self._take()) is not None:
                messages.append(message)
        return messages

    async def execute(self, messages: list[tuple[bytes, int, bool]]) -> None:
        """Call the callback with each message."""
        for message in messages:
            self._callback(*message)

    def drain(self) -> None:
        """Call the callback with all waiting messages. Call this in the thread that spins the node."""
        for message in self.take_data():
            self._callback(*message)

    def _take(self) -> tuple[bytes, int, bool] | None:
        value, info = ctypes.c_bool(), _MessageInfo()  # the C type std_msgs__msg__Bool is one bool
        status = _rcl_take()(
            self._subscription.handle.pointer, ctypes.byref(value), ctypes.byref(info), None
        )
        if status != _OK:
            if status != _NOTHING:
                self._logger.error(
                    f"a message on {self._subscription.topic_name} is lost: rcl_take returns {status}"
                )
            return None
        return bytes(info.publisher_gid.data), info.source_timestamp, value.value
