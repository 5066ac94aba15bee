# SPDX-License-Identifier: Apache-2.0
"""The Python examples of docs/api.md are run, in their order, and the modules it names exist."""

import importlib.util
import re
from pathlib import Path

import pytest
from recorded_run import simulated_run, write_bag

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "api.md").read_text(encoding="utf-8")


def test_the_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "bags" / "run_01", simulated_run(5))
    examples = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert len(examples) == 3
    names: dict[str, object] = {}
    for example in examples:
        exec(example, names)
    told = capsys.readouterr().out
    assert "3.46 mm/s and 3.20 W at φ = +1.10 mm" in told
    assert "the twin ends" in told


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(worm_\w+\.[\w.]+)`", PAGE))))
def test_its_modules_exist(name: str):
    assert importlib.util.find_spec(name) is not None
