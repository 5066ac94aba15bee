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

_LOOK_S = 0.1  # period of the checks for the end, s
# Time for which a page without connection may reconnect, as a multiple of the timeout of control. The page loses
# control at once, even if it reconnects later.
_RECONNECT = 3.0


def serve(
    state: ConsoleState, access: Access, host: str, port: int, ended: Callable[[], int]
) -> None:
    """Start the worker, and serve the pages until ``ended`` returns a nonzero number. The caller closes the worker."""
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
    """Wrap all middleware. This is possible only after the start, which builds the middleware."""
    app.middleware_stack = IgnoreDisconnects(app.middleware_stack)
