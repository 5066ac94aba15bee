# SPDX-License-Identifier: Apache-2.0
import json
import re
import sys
from pathlib import Path

import pyarrow.parquet as parquet
import pytest
from recorded_run import simulated_run, write_bag
from study_cases import SMALL, contents

from worm_optimizer.commands import study as command

ROOT = Path(__file__).resolve().parents[4]
pytestmark = pytest.mark.timeout(300)


def run(monkeypatch, capsys, *words: str) -> tuple[int, str, str]:
    """Exit status, standard output and error of `study`."""
    monkeypatch.setattr(sys, "argv", ["study", *words])
    status = command.main()
    said = capsys.readouterr()
    return status, said.out, said.err


def test_a_study_on_this_machine_and_its_page(tmp_path, monkeypatch, capsys):
    file, output, page = tmp_path / "s.yaml", tmp_path / "s.zarr", tmp_path / "s.html"
    file.write_text(SMALL)
    words = (str(file), "--output", str(output), "--workers", "1", "--json")
    status, out, err = run(monkeypatch, capsys, *words)
    assert status == 0
    assert json.loads(out) == {"points": 6, "done": 6, "failed": 3, "output": str(output)}
    assert "100%" in err
    before = contents(output)
    status, out, _ = run(
        monkeypatch, capsys, *words, "--page", str(page)
    )  # nothing is left to compute
    assert status == 0
    assert contents(output) == before
    text = page.read_text()
    assert "the highest speed at 2.6 W" in text
    assert "less than half the pitch" in text
    assert "whether it stays so over a run is not modelled" in text
    assert (
        text.count("data:image/png;base64,") == 1
    )  # one quantity varies among the points that are done
    status, _, err = run(monkeypatch, capsys, *words, "--page", str(page))
    assert status == 2
    assert "exists already" in err


def test_a_dry_run_tells_points_gaits_and_time_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    file = tmp_path / "s.yaml"
    file.write_text(SMALL)
    status, out, _ = run(monkeypatch, capsys, str(file), "--dry-run", "--json")
    told = json.loads(out)
    assert status == 0
    assert (told["points"], told["blocks"], told["done"]) == (6, 6, 0)
    assert told["gaits"] > 6 * 35
    assert told["seconds"] > 0.0
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ((), "give either STUDY.yaml or --bags FOLDER"),
        (("absent.yaml",), "absent.yaml: cannot be read"),
        (("s.yaml",), "--output is missing"),
        (("s.yaml", "--output", "no/s.zarr"), "make it first"),
        (("s.yaml", "--output", "s.zarr", "--workers", "0"), "give at least 1"),
        (("--bags", "."), "name the fleet's table"),
        (("--bags", ".", "--output", "f.parquet"), "holds no bag"),
        (("--bags", "absent", "--output", "f.parquet"), "does not exist"),
        (("s.yaml", "--parameters", "absent.yaml", "--dry-run"), "cannot be read"),
    ],
)
def test_bad_input_is_one_line_and_status_2(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SMALL)
    status, out, err = run(monkeypatch, capsys, *words)
    assert status == 2
    assert message in err
    assert err.count("\n") == 1
    assert not out


def test_a_fleet_is_a_table_with_a_row_for_the_broken_bag(tmp_path, monkeypatch, capsys):
    folder, output, page = tmp_path / "bags", tmp_path / "f.parquet", tmp_path / "f.html"
    write_bag(folder / "good", simulated_run(5, 1))
    (folder / "broken").mkdir()
    (folder / "broken" / "x.mcap").write_bytes(b"junk")
    words = ("--bags", str(folder), "--output", str(output), "--workers", "1", "--json")
    status, out, _ = run(monkeypatch, capsys, *words, "--page", str(page))
    assert status == 0
    assert json.loads(out) == {"points": 2, "done": 2, "failed": 1, "output": str(output)}
    rows = {row["bag"]: row for row in parquet.read_table(output).to_pylist()}
    assert rows["broken/x.mcap"]["state"] == "failed"
    assert "is not an MCAP file" in rows["broken/x.mcap"]["reason"]
    assert rows["good"]["speed_m_s"] == pytest.approx(rows["good"]["expected_speed_m_s"], rel=0.1)
    assert "is not an MCAP file" in page.read_text()
    assert not list(tmp_path.glob("*.part"))
    assert run(monkeypatch, capsys, *words)[0] == 0  # all is there
    write_bag(folder / "new", simulated_run(5, 2))
    status, _, err = run(monkeypatch, capsys, *words)
    assert status == 2
    assert "nothing is overwritten" in err


def test_the_examples_are_studies(monkeypatch, capsys):
    files = sorted((ROOT / "examples").glob("*.yaml"))
    assert files
    for file in files:
        status, out, _ = run(monkeypatch, capsys, str(file), "--dry-run", "--json")
        assert status == 0
        assert json.loads(out)["points"] >= 2


def test_the_page_of_studies_tells_every_key():
    from worm_optimizer.study import plan

    page = (ROOT / "docs/studies.md").read_text()
    told = set(re.findall(r"`(\w+)`", page))
    assert {*plan.OTHER_UNITS, *plan.COMPUTABLE, *plan.METHODS} <= told
    assert set(plan._KEYS) <= told
