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


def test_a_parameter_that_takes_effect_at_configure_is_rejected_until_cleanup():
    for name, value in (("port", "/dev/other"), ("limits.max_stroke_m", 0.06)):
        assert "deactivate" in reason(name, value, configured=True)
        assert reason(name, value, configured=False) == ""
    # a limit may be lowered at any time
    assert reason("limits.max_stroke_m", 0.04, configured=True) == ""
    # and so may the heartbeat of the next goal, but not the clock
    assert reason("heartbeat_s", 1.0, configured=True) == ""
    assert "clock" in reason("use_sim_time", True, configured=False)
