# SPDX-License-Identifier: Apache-2.0
"""Bad input of the command start, before any node is started."""

import sys

import pytest

from worm_optimizer.commands import start


def test_an_unusable_domain_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(sys, "argv", ["start", "--virtual"])
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    assert start.main() == 1
    lines = [line for line in capfd.readouterr().err.splitlines() if "the logs" not in line]
    assert len(lines) == 1
    assert "ROS_DOMAIN_ID is '300'" in lines[0]
