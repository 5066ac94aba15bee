# SPDX-License-Identifier: Apache-2.0
"""The example of docs/identification.md, which calls single stages, is run."""

import re
from pathlib import Path

import numpy as np
import pytest
from virtual_campaign import Instruments, exact_run

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.run_writer import write_run
from worm_model.gait import Gait
from worm_model.parameters import PAPER

PAGE = Path(__file__).resolve().parents[4] / "docs" / "identification.md"


@pytest.mark.night
def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    bags = [Gait(0.08, 0.15), Gait(0.08, 0.25)]
    for number, gait in enumerate(bags, 1):
        run = exact_run(gait, PAPER, Instruments(), number, 2.5 / gait.frequency)
        (tmp_path / "bags").mkdir(exist_ok=True)
        with new_bag(tmp_path / "bags" / f"run_{number:02d}") as writer:
            write_run(writer, run)
    random = np.random.default_rng(0)
    lines = [f"{x},{968.8 * x + random.normal(0.0, 0.3)}" for x in np.linspace(0.0, 0.07, 30)]
    (tmp_path / "bellows.csv").write_text("compression_m,force_N\n" + "\n".join(lines))
    (example,) = re.findall(
        r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    names: dict[str, object] = {}
    exec(example, names)
    reported = capsys.readouterr().out
    assert "k_b = 9" in reported
    assert "δ_s = 8." in reported or "δ_s = 7.9" in reported
    assert "η = " in reported
    assert names["locomotion"].viscous_friction.identifiable
