# SPDX-License-Identifier: Apache-2.0
"""Style and script of every page: connection, keys and appearance."""

from __future__ import annotations

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
_STYLE = """<style>
.nicegui-content { padding: .4rem .8rem; gap: .2rem }
.q-tab-panel { padding: 0 } .q-tab-panels { background: transparent }
h1 { font-size: 1.1rem; line-height: 1.4; font-weight: 500 }
.cockpit { display: grid; gap: .2rem 1rem; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr) minmax(0, 1.25fr) }
.cockpit > .top { grid-column: 1 / -1 }
.cockpit > section { display: flex; flex-direction: column; gap: .25rem; min-width: 0 }
.line { min-height: 1.5rem } .minutes .line { min-height: 2.7rem; line-height: 1.3 }
.note { min-height: 1.2rem; font-size: .8rem; line-height: 1.2 }
.message { flex: 1 1 20rem }
.error { color: #b71c1c } .body--dark .error { color: #ff8a80 }
.scene { width: 100%; height: 25vh; min-height: 8rem } .scene svg { width: 100%; height: 100%; display: block }
.worm text { font: 7px sans-serif; fill: currentColor }
.worm * { vector-effect: non-scaling-stroke; stroke-width: 2 }
.worm .pipe { fill: #8a8d9855; stroke: #8a8d98; stroke-width: 1.5 }
.worm .scale { stroke: currentColor } .worm .anchor { fill: currentColor }
.worm .bellows { fill: #0072b218; stroke: #0072b2; stroke-width: 1.5 }
.worm .module { fill: #bfd7ea; stroke: #0072b2 }
.worm .cable { stroke: currentColor }
.worm .twin { fill: none; stroke: #d55e00; stroke-dasharray: 6 4 }
.worm .robot ~ .twin:not(.module) { stroke: none } /* only its modules next to the measured robot */
.worm .fin { fill: none; stroke-width: 5; stroke-linecap: round }
.worm .hold { stroke: #1ab333 } .worm .yield { stroke: #f2991a; stroke-dasharray: 5 9 }
.worm .touch { stroke: #999; stroke-width: 3 }
.legend { display: flex; flex-wrap: wrap; gap: 0 .6rem; font-size: .7rem; font-variant-numeric: tabular-nums }
.legend svg { display: inline-block; width: 20px; height: 10px }
.chart { position: relative; font-size: .75rem } .chart .area { position: relative; height: 18vh; min-height: 7rem }
.chart.front .area { height: 30vh } .chart .area { margin: .5rem .6rem 1.1rem 2.6rem }
.chart .area svg { position: absolute; inset: 0; width: 100%; height: 100%; overflow: visible; pointer-events: none }
.chart .area i { position: absolute; font-style: normal; line-height: 1 }
.chart .area .x { top: calc(100% + .25rem); transform: translateX(-50%) }
.chart .area .y { right: calc(100% + .3rem); transform: translateY(50%) }
.chart .axis { text-align: center; line-height: 1 }
.chart path, .sample path { fill: none; vector-effect: non-scaling-stroke }
.grid { stroke: #88888855; stroke-width: 1 }
.curve { stroke-width: 1.5; stroke: #0072b2 } .body--dark .curve.measured { stroke: #56b4e9 }
.curve.twin { stroke: #d55e00; stroke-dasharray: 5 3 }
.curve.commanded { stroke: #99999988; stroke-width: 4 } .curve.cable { stroke: #009e73; stroke-width: 1 }
.front { cursor: pointer } .dots { stroke: #0072b2; stroke-width: 9; stroke-linecap: round }
.dots.chosen { stroke: #d55e00; stroke-width: 16 }
.numbers { display: grid; grid-template-columns: 1fr auto auto; gap: 0 1rem }
.numbers .value { text-align: right; font-variant-numeric: tabular-nums; min-width: 4rem }
.fields { display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 0 .6rem; align-items: end }
.profile { grid-column: span 2; justify-self: start }
.footer { display: flex; align-items: center; gap: .3rem .6rem; padding: .3rem .8rem; flex-wrap: wrap }
.footer .state { flex: 1 1 10rem; order: 1; display: flex; gap: .2rem 1rem; flex-wrap: wrap }
#state { font-weight: 600 }
.stop { order: 2; font-weight: 700; font-size: 1.3rem; min-height: 2.9rem; min-width: 11rem }
@media (max-width: 1000px) {
  .cockpit { grid-template-columns: minmax(0, 1fr) } .cockpit > .choice { display: contents }
  .front-note { order: 1 } .cockpit > .minutes { order: 2 }
  .scene { height: 11vh; min-height: 5rem } .worm text { font-size: 14px } .chart.front .area { height: 16vh }
  h1 { position: absolute; clip-path: inset(50%); width: 1px }
  .footer .state { flex-basis: 100%; order: 0; flex-wrap: nowrap; white-space: nowrap; overflow: hidden }
  .footer .stop { margin-left: auto; min-width: 9rem }
}
.q-footer { z-index: 9000 } /* nothing may cover STOP */
:focus-visible { outline: 3px solid #ff8f00 !important; outline-offset: 2px }
#connection:not(:empty) { background: #b71c1c; color: white; font-size: 1.2rem; padding: .5rem 1rem; flex-basis: 100% }
.no-connection main { filter: grayscale(1); opacity: .4 } .no-connection [role=status] { opacity: .4 }
.no-connection .needs-connection { visibility: hidden }
#popup, #q-loading-bar { display: none } /* the page has its own message */
</style>"""


def head(timeout_s: float) -> str:
    """Return the head of a page. After ``timeout_s`` without acknowledgement, the page counts as disconnected."""
    timeout = f"<script>pageState.timeout = {1e3 * timeout_s:.0f}</script>"
    return _STYLE + _SCRIPT + timeout
