# SPDX-License-Identifier: Apache-2.0
"""The report of readiness, from a process to its listener."""

import os
import select
import subprocess
import sys
from contextlib import closing

from worm_msgs.readiness import Readiness, announce

ANNOUNCE = [sys.executable, "-c", "from worm_msgs.readiness import announce; announce()"]


def test_a_started_process_reports_to_its_own_listener_only():
    with closing(Readiness()) as first, closing(Readiness()) as second:
        subprocess.run(ANNOUNCE, env={**os.environ, **second.environment}, check=True)
        assert select.select([first, second], [], [], 20.0)[0] == [second]
        assert second()
        assert second()  # it remains ready
        assert not first()


def test_what_is_no_report_is_passed_over():
    with closing(Readiness()) as ready:
        subprocess.run(
            [sys.executable, "-c", f"import socket; socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto("
             f"b'STATUS=busy', chr(0) + {ready.environment['NOTIFY_SOCKET'][1:]!r})"],
            check=True,
        )  # fmt: skip
        assert not ready()


def test_a_missing_listener_is_no_error(monkeypatch):
    ready = Readiness()
    ready.close()
    monkeypatch.setenv("NOTIFY_SOCKET", ready.environment["NOTIFY_SOCKET"])
    announce()
    monkeypatch.delenv("NOTIFY_SOCKET")
    announce()
