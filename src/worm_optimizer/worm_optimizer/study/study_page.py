# SPDX-License-Identifier: Apache-2.0
"""HTML page of a study: the best point, its neighbours, Sobol indices, failed points, and limits of the model."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from worm_optimizer.robustness.sobol import INDEX_HEADS, Indices, index_cells
from worm_optimizer.study.plan import Study
from worm_optimizer.study.study_plots import label, pictures, shown
from worm_optimizer.study.study_run import open_result
from worm_optimizer.study.summary import Summary, study_indices, summarise

_BEST = 10  # largest number of rows of the tables of best points and of failures
# Limit of the model that the page states if the study varies the quantity
_COUPLED = {
    "bellows_stiffness": "A stiffer bellows extends faster: on a real robot time_constant, gain and slack change, too. "
    "Here they keep their values unless the study varies them; bellows_stiffness alone then affects only the cable "
    "force and the power.",
    "bellows_damping": "Damping and stiffness of a bellows depend on the same material; here they vary independently.",
    "slack": "Less slack needs a tighter cable. The model does not compute whether the cable stays tight during a run.",
    "pitch": "Another pitch needs other fins, but threshold and stiffnesses keep their values unless the study varies "
    "them. With a fixed initial_length, the groove phase changes with the pitch (vary or fix groove_phase_m).",
    "clearance": "Clearance depends on the shape of the fin, but the fin's stiffnesses keep their values unless "
    "the study varies them.",
    "switching_threshold": "Threshold and stiffnesses depend on the same shape and material of the fin, but the "
    "stiffnesses keep their values unless the study varies them.",
    "spool_radius_m": "The spool radius affects speed and force of the servos only. Winding and inertia are not "
    "modelled.",
}
# Limits of the model that each page states
_ALWAYS = (
    "All numbers hold for the groove phase of the point, except those of any-phase gaits and for an unknown phase. A "
    "robot with another groove phase may gain other numbers of grooves.",
    "Designs cannot be ranked if their results differ by less than what the uncertainty of the parameters can cause.",
)


@dataclass(frozen=True)
class Table:
    """Table with a title; ``words`` is True if the cells contain text rather than numbers."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: bool = False


def write_page(output: Path, study: Study, page: Path) -> None:
    """Write the HTML page ``page`` about the results in the file ``output``.

    Raises:
        FileExistsError: The page exists already.
    """
    summary, indices = summarise(output, study), study_indices(output, study)
    with open_result(output) as data:
        origin = {key: data.attrs[key] for key in ("study_hash", "code")}
        versions = json.loads(data.attrs["versions"])
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters["base64"] = lambda content: base64.b64encode(content).decode()
    template = Path(__file__).with_name("study.html.jinja").read_text(encoding="utf-8")
    content = environment.from_string(template).render(
        study=study,
        lead=_lead(summary),
        tables=[
            _best_table(summary),
            *_indices_table(indices, [axis.name for axis in study.ranges]),
            *_failed_table(summary),
        ],
        images=pictures(summary),
        limits=[*(text for key, text in _COUPLED.items() if key in study.varied), *_ALWAYS],
        origin=json.dumps({**origin, **versions}, indent=1),
    )
    with page.open("x", encoding="utf-8") as file:
        file.write(content)


def _lead(summary: Summary) -> list[str]:
    failed = sum(summary.failed.values())
    lines = [
        f"{summary.points} points are computed"
        + (f"; {failed} of them failed" if failed else "")
        + (f"; {summary.still} have no {label(summary.figures[0])}" if summary.still else "")
        + "."
    ]
    if summary.best is None:
        return [*lines, f"No point has {summary.goal}."]
    lines.append(f"Best is {summary.goal}: {_sentence(summary, summary.best)}")
    return lines


def _sentence(summary: Summary, row: int) -> str:
    """Return a design and its results as text."""
    design, figures = (
        ", ".join(f"{label(column)} {shown(column)[row]:.4g}" for column in columns)
        for columns in (summary.varied, summary.figures)
    )
    return f"{design}. Results: {figures}."


def _best_table(summary: Summary) -> Table:
    columns = [*summary.varied, *summary.figures]
    order = summary.rank.argsort()[: min(_BEST, len(summary.rank) - summary.still)]
    rows = [[f"{shown(column)[row]:.4g}" for column in columns] for row in order]
    return Table(f"The best, by {summary.goal}", [label(column) for column in columns], rows)


def _indices_table(indices: Mapping[str, Indices], inputs: Sequence[str]) -> list[Table]:
    if not indices:
        return []
    rows = [
        [name, key, *index_cells(each, k)]
        for name, each in indices.items()
        for k, key in enumerate(inputs)
    ]
    return [Table("Sobol indices", ("result", "quantity", *INDEX_HEADS), rows, words=True)]


def _failed_table(summary: Summary) -> list[Table]:
    if not summary.failed:
        return []
    rows = [[reason, str(count)] for reason, count in summary.failed.most_common(_BEST)]
    return [Table("Points that failed", ["reason", "points"], rows, words=True)]
