# SPDX-License-Identifier: Apache-2.0
"""Wait for what another thread does."""

import time
from collections.abc import Callable

TIMEOUT_S = 60.0  # only a failing test waits so long


def wait_for(condition: Callable[[], object]) -> None:
    """Return as soon as a condition is fulfilled."""
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.001)
