# SPDX-License-Identifier: Apache-2.0
"""Style and script of every page: connection, keys and appearance."""

from __future__ import annotations

from worm_optimizer.console.page_chart import STYLE

MESSAGE_MS = 500  # period of a page's messages to the server
STOP_KEY = "Escape"
NO_CONNECTION = (
    "This page has no connection to the console. It shows old values and has no control."
)
_NOT_DELIVERED = "STOP CANNOT BE DELIVERED: use the switch in the supply, or another page."

# The server acknowledges each message. A page without acknowledgements shows that it has no connection. The first
# message after the connection is restored reports the interruption, so that the server ends the page's control.
_SCRIPT = f"""<script>
if (top !== self) document.documentElement.remove();  // no other site may show the page and capture its clicks
const pageState = {{timeout: Infinity, acknowledged: performance.now(), connected: true, wasAway: false}};
function showConnection(connected) {{
  if (connected === pageState.connected) return;
  pageState.connected = connected;
  document.body.classList.toggle("no-connection", !connected);
  document.querySelectorAll("main, .needs-connection").forEach((part) => part.inert = !connected);
  document.querySelector("#connection").textContent = connected ? "" : "{NO_CONNECTION}";
  if (!connected) pageState.wasAway = true;
}}
function acknowledge() {{
  pageState.acknowledged = performance.now();
  showConnection(true);
}}
function sendMessage() {{
  if (performance.now() - pageState.acknowledged > pageState.timeout) showConnection(false);
  if (!window.socket?.connected) return;
  emitEvent("alive", pageState.wasAway);
  pageState.wasAway = false;
}}
addEventListener("load", () => {{
  window.socket.on("disconnect", () => showConnection(false));
  setInterval(sendMessage, {MESSAGE_MS});
}});
addEventListener("click", (event) => {{
  if (pageState.connected || !event.target.closest?.("#stop")) return;
  event.preventDefault(); event.stopImmediatePropagation();
  document.querySelector("#connection").textContent = "{_NOT_DELIVERED}";
}}, true);
addEventListener("keydown", (event) => {{
  if (event.key === "{STOP_KEY}" && !event.repeat) document.querySelector("#stop").click();
}}, true);
</script>"""
_STYLE = (
    f"<style>{STYLE}"
    + """
.scene { aspect-ratio: 3.4; max-height: 27vh; width: 100% }
.scene svg { width: 100%; height: 100%; display: block }
.worm .pipe { fill: #8d8d99 } .worm .robot { fill: #2659bf } .worm .ghost { fill: #e6b422; opacity: .45 }
.worm .bellows { opacity: .5 } .worm .ghost.bellows { opacity: .25 } .worm .fins { opacity: .9 }
.worm text { font: 8px sans-serif; fill: currentColor }
@media (max-width: 600px) { .worm text { font-size: 14px } }
.worm path.scale { stroke: currentColor; stroke-width: 1.5 }
.numbers .value { text-align: right; font-variant-numeric: tabular-nums; min-width: 5.5rem }
.line { min-height: 1.5rem } .error { color: #b71c1c } .body--dark .error { color: #ff8a80 }
.stop { font-weight: 700; font-size: 1.4rem; min-height: 3.2rem; min-width: 11rem }
.q-footer { z-index: 9000 } .q-notifications__list--bottom { bottom: 9rem } /* nothing may cover STOP */
:focus-visible { outline: 3px solid #ff8f00 !important; outline-offset: 2px }
#connection:not(:empty) { background: #b71c1c; color: white; font-size: 1.2rem; padding: .5rem 1rem; flex-basis: 100% }
.no-connection main { filter: grayscale(1); opacity: .4 } .no-connection [role=status] { opacity: .4 }
.no-connection .needs-connection { visibility: hidden }
#popup, #q-loading-bar { display: none } /* the page has its own message */
</style>"""
)


def head(timeout_s: float) -> str:
    """Return the head of a page. After ``timeout_s`` without acknowledgement, the page counts as disconnected."""
    timeout = f"<script>pageState.timeout = {1e3 * timeout_s:.0f}</script>"
    return _STYLE + _SCRIPT + timeout
