# SPDX-License-Identifier: Apache-2.0
"""The web server of the console: pages, the guard before them, and the worker behind them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from nicegui import app, ui
from nicegui.server import Server

from worm_optimizer.console.access import Access
from worm_optimizer.console.entrance import Guard
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.pages import build

_LOOK_S = 0.1
_RECONNECT_S = 15.0  # for which a page is kept that lost its connection, or is slow to come; control is lost before


def serve(hub: Hub, access: Access, host: str, port: int, ended: Callable[[], int]) -> None:
    """Serve the pages until they have ``ended``; the worker begins with them, and is left to whoever made it."""
    # The server's own handlers would at a second signal leave all that it has begun.
    Server.capture_signals = lambda _: nullcontext()
    app.timer(_LOOK_S, lambda: app.shutdown() if ended() else None)
    build(hub, access)
    app.add_middleware(Guard, access=access)
    app.on_startup(hub.worker.start)
    ui.run(
        host=host,
        port=port,
        title="Worm console",
        dark=None,
        reload=False,
        show=False,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT_S,
    )
