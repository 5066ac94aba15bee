# SPDX-License-Identifier: Apache-2.0
"""When parameters of the driver can be set, and the reason where they cannot."""

from types import SimpleNamespace

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from rclpy.parameter import Parameter

from worm_driver.nodes.driver_parameters import why_not_set


def reason(name: str, value: object, *, configured: bool) -> str:
    present = SimpleNamespace(get_parameter=lambda _: SimpleNamespace(value=0.05))
    return why_not_set(present, [Parameter(name, value=value)], configured=configured)


@pytest.mark.parametrize("configured", [False, True])
@pytest.mark.parametrize("name", ["autostart", "stay_on_failure"])
def test_a_parameter_that_is_read_at_the_start_is_rejected_with_this_reason(name, configured):
    """Cleanup would not make the change effective."""
    rejected = reason(name, True, configured=configured)
    assert rejected.startswith(f"{name}:")
    assert "start" in rejected
    assert "clean up" not in rejected


def test_the_heartbeat_of_the_next_goal_may_change_at_any_time():
    assert reason("heartbeat_s", 1.0, configured=True) == ""
