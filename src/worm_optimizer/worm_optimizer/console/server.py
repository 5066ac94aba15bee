# SPDX-License-Identifier: Apache-2.0
"""The web server of the console: its pages, and the worker that operates the robot."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import nullcontext

from nicegui import app, core, ui
from nicegui.server import Server
from starlette.middleware.trustedhost import TrustedHostMiddleware

from worm_optimizer.console.console_page import build
from worm_optimizer.console.console_state import ConsoleState

HOST = "127.0.0.1"
_LOOK_S = 0.1  # period of the checks for the end, s
# Time for which a page without connection may reconnect, as a multiple of the timeout of control. The page loses
# control at once, even if it reconnects later.
_RECONNECT = 3.0


def serve(state: ConsoleState, port: int, ended: Callable[[], int]) -> None:
    """Start the worker, and serve the pages until ``ended`` returns a nonzero number. The caller closes the worker.

    Pages of other sites, which the browser of this computer may show, cannot connect: the host name and the origin of a
    request must be those of the console.
    """
    # The server's own handlers would exit at a second signal without closing the worker.
    Server.capture_signals = lambda _: nullcontext()
    app.timer(_LOOK_S, lambda: app.shutdown() if ended() else None)
    build(state)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    core.sio.eio.cors_allowed_origins = None  # only the console's own origin
    app.on_startup(state.worker.start)
    logging.getLogger("uvicorn.error").addFilter(_is_no_disconnect)
    ui.run(
        host=HOST,
        port=port,
        title="Worm console",
        dark=None,
        reload=False,
        language="en-US",
        show=False,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT * state.control.timeout_s,
        ws_ping_interval=None,  # only `PageControl` decides how long a slow page may be silent
    )


def _is_no_disconnect(record: logging.LogRecord) -> bool:
    """Return False for the error that Starlette's middleware raises when a client leaves before the response."""
    return "No response returned" not in str(record.exc_info and record.exc_info[1])
