# SPDX-License-Identifier: Apache-2.0
"""Reports whose figures of single gaits are drawn but not rendered, which takes three seconds per gait."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import save_png_and_pdf


def leave_runs_unrendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reports write placeholders instead of rendered figures of single gaits. All other figures are rendered."""

    def save(figure: Figure, stem: Path) -> None:
        if stem.name.startswith("run_"):
            assert figure.axes
            for ending in (".png", ".pdf"):
                Path(f"{stem}{ending}").write_bytes(b"not rendered")
        else:
            save_png_and_pdf(figure, stem)

    monkeypatch.setattr("worm_optimizer.report.report_page.save_png_and_pdf", save)
