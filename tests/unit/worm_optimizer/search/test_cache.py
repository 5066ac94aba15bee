# SPDX-License-Identifier: Apache-2.0
"""Results on disk: found again only for exactly what they were made of, never half written."""

import ast
import dataclasses
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from gaits_for_tests import QUICK, cache_in, made_up_front

from worm_model.parameters import PAPER, ParameterFile
from worm_optimizer.search import cache as cache_module
from worm_optimizer.search.cache import (
    Cache,
    default_directory,
    fingerprint,
    key_of,
    scan_key_of,
    sources,
)
from worm_optimizer.search.front import RobustFront
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.optimizer_errors import OptimizerError

FILE = ParameterFile(intervals={"slack": (0.0075, 0.0085)})


def test_a_front_survives_the_file(tmp_path):
    cache, front = cache_in(tmp_path), made_up_front()
    cache.store("front", front.as_dict())
    assert cache.load("front", RobustFront.from_dict) == front


def test_not_a_number_survives_the_file(tmp_path):
    cache = cache_in(tmp_path)
    cache.store("scan", [1.0, math.nan])
    assert math.isnan(cache.load("scan", lambda rows: rows[1]))


@pytest.mark.parametrize("text", ["", "{", "[]", '{"margin": 1}', "null", "\x00\x01"])
def test_a_broken_file_counts_as_absent(tmp_path, text):
    cache = cache_in(tmp_path)
    (cache.directory / "front.json").write_text(text)
    assert cache.load("front", RobustFront.from_dict) is None


def test_what_was_never_stored_is_absent(tmp_path):
    assert cache_in(tmp_path).load("front", RobustFront.from_dict) is None


def test_storing_replaces_in_one_step_and_leaves_nothing_beside(tmp_path):
    cache = cache_in(tmp_path)
    for value in (1, 2):
        cache.store("number", value)
    assert cache.load("number", int) == 2
    assert [path.name for path in cache.directory.iterdir()] == ["number.json"]


def test_what_cannot_be_written_down_leaves_the_old_file_alone(tmp_path):
    cache = cache_in(tmp_path)
    cache.store("number", 1)
    with pytest.raises(TypeError):
        cache.store("number", object())
    assert cache.load("number", int) == 1
    assert [path.name for path in cache.directory.iterdir()] == ["number.json"]


def test_a_folder_that_cannot_be_written_to_is_refused(tmp_path):
    file = tmp_path / "file"
    file.write_text("")
    with pytest.raises(OptimizerError, match="cannot be written to"):
        Cache.at(file / "cache")


def test_the_name_changes_with_everything_that_matters():
    other_settings = dataclasses.replace(QUICK, search=SearchSettings(seed=2))
    names = {
        key_of(FILE, QUICK, 1),
        key_of(FILE, QUICK, -1),
        key_of(FILE, other_settings, 1),
        key_of(FILE, dataclasses.replace(QUICK, margin=1e-3), 1),
        key_of(ParameterFile(PAPER.replace(slack=0.0081)), QUICK, 1),
        key_of(ParameterFile(), QUICK, 1),
        key_of(ParameterFile(PAPER.replace(one_sided_cable=True)), QUICK, 1),
        key_of(dataclasses.replace(FILE, correlations={("slack", "gain"): 0.5}), QUICK, 1),
        key_of(dataclasses.replace(FILE, run_to_run={"initial_length": 1e-4}), QUICK, 1),
    }
    assert len(names) == 9


def test_the_name_does_not_change_with_what_does_not_matter():
    told = dataclasses.replace(FILE, provenance={"bags": ["a"]})
    assert key_of(told, QUICK, 1) == key_of(FILE, QUICK, 1)
    other_settings = dataclasses.replace(QUICK, search=SearchSettings(seed=2), samples=7)
    uncertain = dataclasses.replace(FILE, run_to_run={"initial_length": 1e-4})
    assert scan_key_of(ParameterFile(), other_settings, 1) == scan_key_of(uncertain, QUICK, 1)


def test_names_are_the_same_in_every_process():
    """A name that depended on the process would never be found after a restart."""
    assert key_of(ParameterFile(), QUICK, 1) == key_of(ParameterFile(), QUICK, 1)
    assert json.dumps(key_of(ParameterFile(), QUICK, 1)).isascii()


def test_the_name_depends_on_all_code_that_results_depend_on(tmp_path, monkeypatch):
    ours = "[m.__file__ for n, m in sys.modules.items() if n.startswith('worm_')]"
    code = f"import sys, worm_optimizer.search.front; print({ours})"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {Path(name).resolve() for name in ast.literal_eval(told.stdout)}
    known = {path.resolve() for path in sources()}
    assert {path for path in loaded if path.name != "__init__.py"} <= known

    before = key_of(ParameterFile(), QUICK, 1)
    changed = tmp_path / "gait_map.py"
    changed.write_text("another method")
    monkeypatch.setattr(cache_module, "sources", lambda: [changed])
    fingerprint.cache_clear()
    try:
        assert key_of(ParameterFile(), QUICK, 1) != before
    finally:
        fingerprint.cache_clear()


def test_what_a_killed_process_left_behind_is_removed_and_what_is_being_written_is_not(tmp_path):
    cache = cache_in(tmp_path)
    old, new, other = (cache.directory / name for name in (".a.part", ".b.part", "front.json"))
    for path in (old, new, other):
        path.write_text("{")
    two_hours_ago = time.time() - 7200.0
    for path in (old, other):
        os.utime(path, (two_hours_ago, two_hours_ago))
    Cache.at(cache.directory)
    assert sorted(path.name for path in cache.directory.iterdir()) == [".b.part", "front.json"]


def test_the_default_folder_follows_the_environment(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert default_directory() == Path("/somewhere/worm_optimizer")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/someone")
    assert default_directory() == Path("/home/someone/.cache/worm_optimizer")
