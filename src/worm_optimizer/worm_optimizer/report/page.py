# SPDX-License-Identifier: Apache-2.0
"""The report as one self-contained HTML page: no script, nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence

from worm_model.parameters import KEYS, PAPER, SYMBOLS, UNITS, ParameterFile
from worm_optimizer.report.expectation import Band
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.verdict import Agreement, Order, agreements, percent, title_of

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 1080px; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.7em; } h2 { margin-top: 2em; border-bottom: 1px solid #bbb; } h3 { margin-top: 1.6em; }
.wide { overflow-x: auto; margin: 0.8em 0; } table { border-collapse: collapse; }
th, td { padding: 0.25em 0.8em; text-align: left; border-bottom: 1px solid #ddd; vertical-align: top; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: 1.2em 0; } img { max-width: min(100%, 900px); }
@media (max-width: 640px) { img { max-width: none; width: 600px; } }
figcaption { color: #555; font-size: 0.92em; }
.yes::before { content: "\\2713\\00a0"; } .no::before { content: "\\2717\\00a0"; } .no { font-weight: bold; }
details { margin: 0.6em 0; } summary { cursor: pointer; } code { font-size: 0.9em; overflow-wrap: anywhere; }
"""
_UNITS = {"speed": (1e3, "mm/s", 3), "power": (1.0, "W", 3), "cost_of_transport": (1.0, "", 1)}
_NAMES = {"speed": "speed", "power": "power", "cost_of_transport": "cost of transport"}


def write_page(title: str, sections: Iterable[str]) -> str:
    """A page of sections that are HTML already."""
    body = "\n".join(sections)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{_text(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{_text(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def figure(png: bytes, caption: str) -> str:
    """An image inside the page."""
    data = base64.b64encode(png).decode()
    return (
        f'<figure><div class="wide"><img alt="{_text(caption)}" src="data:image/png;base64,{data}"></div>'
        f"<figcaption>{_text(caption)}</figcaption></figure>"
    )


def heading(title: str, note: str = "") -> str:
    """Begins a section, with a remark on what follows if there is one."""
    return f"<h2>{_text(title)}</h2>" + (f"<p>{_text(note)}</p>" if note else "")


def attached_section(title: str, images: Mapping[str, bytes], text: str) -> str:
    """Images (PNG) by caption, and a plain text to unfold."""
    shown = "\n".join(figure(png, caption) for caption, png in images.items())
    return f"{heading(title)}\n{shown}\n<details><summary>Its text</summary><pre>{_text(text)}</pre></details>"


def summary_section(gaits: Sequence[RecordedGait], orders: Sequence[Order], note: str = "") -> str:
    """Measured against expected of all gaits, whether their order is preserved, and a remark."""
    rows = [_agreement_row(row) for gait in gaits for row in agreements(gait)]
    heads = (
        "gait",
        "figure",
        "measured",
        "cycles",
        "expected",
        "95 % interval",
        "difference",
        "agrees",
    )
    notes = (
        "<p>Measured: the mean of the averaged cycles, and the lowest and highest of these cycles. Expected: the "
        "model, from the command alone and without a margin; its interval comes from the uncertainty of the "
        "parameters at the groove phase of the parameter file. They agree where that interval and the span of the "
        "cycles overlap. No number is passed from one to the other.</p>"
    )
    lines = "".join(f"<li>{_order_text(order)}</li>" for order in orders)
    order = f"<h3>Order</h3><ul>{lines}</ul>" if lines else ""
    remark = f"<p>{_text(note)}</p>" if note else ""
    return f"<h2>Measured against expected</h2>{_table(heads, rows, numbers=range(2, 7))}{notes}{order}{remark}"


def _agreement_row(row: Agreement) -> list[str]:
    measured, expected = row.measured, row.expected
    if row.agrees is None:
        verdict = "not measured"
    else:
        verdict = '<span class="yes">yes</span>' if row.agrees else '<span class="no">no</span>'
    return [
        _text(title_of(row.gait)),
        _NAMES[row.quantity],
        _value(measured.value, row.quantity),
        _range(measured, row.quantity),
        _value(expected.value, row.quantity),
        _range(expected, row.quantity),
        percent(row.difference) or "–",
        verdict,
    ]


def _order_text(order: Order) -> str:
    expected = " &lt; ".join(_text(title_of(name)) for name in order.expected)
    if order.measured is None:
        return f"{_NAMES[order.quantity]}: not told, a figure is missing (expected {expected})"
    if order.preserved:
        return f'<span class="yes">{_NAMES[order.quantity]}: preserved, {expected}</span>'
    measured = " &lt; ".join(_text(title_of(name)) for name in order.measured)
    return f'<span class="no">{_NAMES[order.quantity]}: not preserved; expected {expected}, measured {measured}</span>'


def run_section(gait: RecordedGait, figures: Iterable[str]) -> str:
    """One run: what ran, its figures, its events, its provenance."""
    played, nominal, robust = gait.gait, gait.expected.nominal, gait.expected.robust
    way = "forward" if played.direction > 0 else "reverse"
    facts = [
        ("gait", f"stroke {1e3 * played.stroke:.2f} mm, frequency {played.frequency:.4f} Hz, {way}, "
         f"designed with a margin of {1e3 * played.margin:.2f} mm"),
        ("cycles", f"{gait.cycles} asked for; averaged: {gait.averaged_cycles[0]} to {gait.averaged_cycles[1]}"),
        ("expected", f"{nominal.grooves_per_cycle:.2f} grooves per cycle without, "
         f"{robust.grooves_per_cycle:.2f} with the margin, at a groove phase of {1e3 * nominal.groove_phase:+.2f} mm"),
        ("groove phase of the run", f"{_phase_of(gait)} (the twin's, from the length at rest)"),
        ("robust prediction", f"{1e3 * robust.speed:.3f} mm/s, {robust.power:.3f} W"),
        ("twin under the recorded length", f"{1e3 * gait.twin.speed.value:.3f} mm/s, {gait.twin.power.value:.3f} W"),
        ("residuals against the twin", _residual_text(gait)),
        ("parameters", _text(gait.parameter_source)),
        *(("missing", _text(reason)) for reason in gait.missing),
    ]  # fmt: skip
    return "\n".join(
        [
            f"<h2>Run {_text(title_of(gait.name))}</h2>",
            _table(("", ""), [list(row) for row in facts]),
            *figures,
            _cycle_table(gait),
            _event_table(gait),
            _provenance(gait.provenance),
        ]
    )


def parameter_section(content: ParameterFile, source: str, figures: Iterable[str]) -> str:
    """Identified parameters with their intervals beside the paper's values."""
    values, paper = content.parameters.as_dict(), PAPER.as_dict()
    rows = []
    for key in KEYS:
        low, high = content.intervals.get(key, (math.nan, math.nan))
        interval = f"{low:.5g} to {high:.5g}" if math.isfinite(low) else "not given"
        rows.append(
            [f"<code>{key}</code>", _text(SYMBOLS[key]), f"{values[key]:.5g}", interval, f"{paper[key]:.5g}",
             _text(UNITS[key])]
        )  # fmt: skip
    heads = ("parameter", "symbol", "value", "95 % interval", "paper", "unit")
    provenance = {str(key): str(value) for key, value in content.provenance.items()}
    return "\n".join(
        [
            "<h2>Identified parameters</h2>",
            f"<p>From <code>{_text(source)}</code>.</p>",
            *figures,
            _table(heads, rows, numbers=(2, 3, 4)),
            _provenance(provenance) if provenance else "",
        ]
    )


def _phase_of(gait: RecordedGait) -> str:
    phases = gait.replay.states["groove_phase"]
    return f"{1e3 * float(phases[-1]):+.2f} mm" if len(phases) else "unknown"


def _residual_text(gait: RecordedGait) -> str:
    total = gait.judged.residuals
    return (
        f"x1 {1e3 * total.x1_rmse:.2f} mm rms, length {1e3 * total.length_rmse:.2f} mm rms, "
        f"power {total.power_rmse:.2f} W rms, energy {100 * gait.judged.energy_error:+.2f} %"
    )


def _cycle_table(gait: RecordedGait) -> str:
    rows = [
        [
            str(number),
            f"{cycle.measured_grooves:.2f}",
            f"{cycle.grooves:.0f}",
            f"{1e3 * cycle.residuals.x1_rmse:.2f}",
            f"{1e3 * cycle.residuals.length_rmse:.2f}",
            f"{cycle.residuals.power_rmse:.2f}",
        ]
        for number, cycle in enumerate(gait.judged.cycles, 1)
    ]
    heads = (
        "cycle", "grooves measured", "twin", "x1 (mm rms)", "length (mm rms)", "power (W rms)",
    )  # fmt: skip
    return f"<h3>Cycle by cycle</h3>{_table(heads, rows, numbers=range(6))}"


def _event_table(gait: RecordedGait) -> str:
    rows = [
        [
            f"{event.time:.2f}" if math.isfinite(event.time) else "",
            _text(event.source),
            _text(event.level),
            _text(event.text),
        ]
        for event in gait.events
    ]
    return f"<h3>Events</h3>{_table(('time (s)', 'source', 'level', 'what'), rows, numbers=(0,))}"


def _provenance(facts: Mapping[str, str]) -> str:
    rows = [[_text(key), f"<code>{_text(value)}</code>"] for key, value in facts.items()]
    return f"<details><summary>Provenance</summary>{_table(('', ''), rows)}</details>"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], numbers: Iterable[int] = ()) -> str:
    """A table of cells that are HTML already; columns of numbers stand to the right."""
    right = set(numbers)

    def cells(row: Sequence[str], tag: str) -> str:
        return "".join(
            f'<{tag} class="number">{cell}</{tag}>' if i in right else f"<{tag}>{cell}</{tag}>"
            for i, cell in enumerate(row)
        )

    head = f"<tr>{cells(heads, 'th')}</tr>" if any(heads) else ""
    body = "".join(f"<tr>{cells(row, 'td')}</tr>" for row in rows)
    return f'<div class="wide"><table>{head}{body}</table></div>'


def _value(value: float, quantity: str) -> str:
    scale, unit, digits = _UNITS[quantity]
    return f"{scale * value:.{digits}f} {unit}".rstrip() if math.isfinite(value) else "–"


def _range(band: Band, quantity: str) -> str:
    scale, _, digits = _UNITS[quantity]
    if math.isnan(band.low) or math.isnan(band.high):
        return "–"
    return f"{scale * band.low:.{digits}f} to {scale * band.high:.{digits}f}"


def _text(value: str) -> str:
    return html.escape(str(value))
