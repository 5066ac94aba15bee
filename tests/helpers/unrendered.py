# SPDX-License-Identifier: Apache-2.0
"""Reports whose figures of single gaits are drawn but not rendered, which takes four seconds per gait."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import save_figure


def leave_runs_unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reports write placeholders instead of rendered figures of single gaits. All other figures are rendered."""

    def save(figure: Figure, path: Path) -> None:
        if path.name.startswith("run_"):
            assert figure.axes
            path.write_bytes(b"not rendered")
        else:
            save_figure(figure, path)

    monkeypatch.setattr("worm_optimizer.report.report_page.save_figure", save)
