# SPDX-License-Identifier: Apache-2.0
"""The web server of the console: pages, access to them, and the worker that operates the robot."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from nicegui import app, ui
from nicegui.server import Server

from worm_optimizer.console.access import Access
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.entrance import Guard, IgnoreDisconnects
from worm_optimizer.console.pages import build

_LOOK_S = 0.1
# A page without connection exists for so many times the timeout of control; it loses control immediately.
_RECONNECT = 3.0


def serve(
    state: ConsoleState, access: Access, host: str, port: int, ended: Callable[[], int]
) -> None:
    """Serve the pages until ``ended`` returns a number other than 0. They start the worker; the caller closes it."""
    # The server's own handlers would exit at a second signal without closing the worker.
    Server.capture_signals = lambda _: nullcontext()
    app.timer(_LOOK_S, lambda: app.shutdown() if ended() else None)
    build(state, access)
    app.add_middleware(Guard, access=access)
    app.on_startup(state.worker.start)
    app.on_startup(_ignore_disconnects)
    ui.run(
        host=host,
        port=port,
        title="Worm console",
        dark=None,
        reload=False,
        language="en-US",
        show=False,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT * state.control.timeout_s,
    )


def _ignore_disconnects() -> None:
    """Wrap all middleware, which exists from the start on."""
    app.middleware_stack = IgnoreDisconnects(app.middleware_stack)
