# SPDX-License-Identifier: Apache-2.0
"""Where the optional set of studies is not installed, the tests of what needs it are skipped."""

from importlib.util import find_spec
from pathlib import Path

import pytest

NEEDS_IT = {"test_engine.py", "test_results.py", "test_store.py", "test_study_command.py"}


class Absent(pytest.Module):
    """A module of tests that is not imported."""

    def collect(self):
        pytest.skip("needs pip install -r requirements-study.txt", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector):
    if module_path.name in NEEDS_IT and find_spec("distributed") is None:
        return Absent.from_parent(parent, path=module_path)
    return None
