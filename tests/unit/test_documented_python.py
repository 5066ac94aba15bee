# SPDX-License-Identifier: Apache-2.0
"""The Python examples of docs/api.md and the notebooks run; all modules that this page and the glossary name exist."""

import importlib.util
import json
import re
import tempfile
from pathlib import Path

import pytest
from recorded_run import simulated_run, write_bag

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


@pytest.mark.night
def test_the_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    pytest.importorskip("pandas", reason="pandas is optional")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    write_bag(tmp_path / "bags" / "forward", simulated_run(5))
    examples = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(examples) == 3
    names: dict[str, object] = {}
    for example in examples:
        exec(example, names)
    reported = capsys.readouterr().out
    assert "3.46 mm/s and 3.20 W at φ = +1.10 mm" in reported
    assert "the twin ends" in reported
    assert list(tmp_path.glob("*/forward.png"))
    assert list(tmp_path.glob("*/robot.yaml"))
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_file()) == []


@pytest.mark.night
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_runs_and_holds_no_outputs(notebook: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pandas", reason="pandas is optional")
    monkeypatch.chdir(notebook.parent)
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    names: dict[str, object] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            lines = (line for line in cell["source"] if not line.startswith("%"))
            exec("".join(lines), names)


def test_their_modules_exist():
    for name in set(re.findall(r"`(worm_\w+\.[\w.]+)`", PAGE + GLOSSARY)):
        assert importlib.util.find_spec(name) is not None, name
