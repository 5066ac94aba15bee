# SPDX-License-Identifier: Apache-2.0
"""The web server of the console: pages, the guard before them, and the worker behind them."""

from __future__ import annotations

from nicegui import app, ui

from worm_optimizer.console.access import Access
from worm_optimizer.console.entrance import Guard
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.pages import build

_RECONNECT_S = 15.0  # for which a page is kept that lost its connection, or is slow to come; control is lost before


def serve(hub: Hub, access: Access, host: str, port: int) -> None:
    """Serve the pages until a signal comes; the worker begins with them, and is left to whoever made it."""
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
