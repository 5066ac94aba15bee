# SPDX-License-Identifier: Apache-2.0
"""The front that comes with the package is the one that this code computes."""

import json

import pytest

from worm_optimizer.search import shipped
from worm_optimizer.search.cache import SHIPPED, Cache

MAKE_ANEW = "out of date: python -m worm_optimizer.search.shipped makes it anew"


@pytest.mark.timeout(600)
def test_what_is_shipped_is_what_is_computed(tmp_path, monkeypatch):
    monkeypatch.setattr("worm_optimizer.search.cache.SHIPPED", tmp_path / "none")
    shipped.make(tmp_path)
    made = {file.name: json.loads(file.read_text()) for file in tmp_path.glob("*.json")}
    there = {file.name: json.loads(file.read_text()) for file in SHIPPED.glob("*.json")}
    assert set(there) == set(made), MAKE_ANEW
    for name, content in made.items():
        assert _numbers(there[name]) == pytest.approx(_numbers(content), rel=1e-9, nan_ok=True)


def test_a_cache_finds_what_is_shipped_and_prefers_its_own(tmp_path):
    names = sorted(file.stem for file in SHIPPED.glob("scan-*.json"))
    cache = Cache.at(tmp_path)
    assert all(cache.load(name, list) for name in names)
    for name in names:
        cache.store(name, [1.0])
        assert cache.load(name, list) == [1.0]


def _numbers(content):
    if isinstance(content, dict):
        return [number for key in sorted(content) for number in _numbers(content[key])]
    if isinstance(content, list):
        return [number for part in content for number in _numbers(part)]
    numeric = isinstance(content, int | float) and not isinstance(content, bool)
    return [float(content)] if numeric else []
