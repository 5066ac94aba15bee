# SPDX-License-Identifier: Apache-2.0
"""The fingerprint depends on the code that identification uses, and on no other."""

from worm_model.identification.fingerprint import ENTRY, PACKAGE, imported_files


def test_what_identification_imports_is_in_it_and_nothing_else():
    files = {str(file.relative_to(PACKAGE)) for file in imported_files(PACKAGE, ENTRY)}
    assert {
        "commands/identify.py",
        "identification/fits/groove_scatter.py",
        "identification/data/lab_logs.py",
    } <= files
    assert {"simulation/simulator.py", "simulation/smoothing.py", "bags/run_reader.py"} <= files
    assert not {"twin/core.py", "nodes/twin_node.py", "commands/health.py"} & files


def test_imports_are_followed_in_every_form(tmp_path):
    package = tmp_path / "thing"
    package.mkdir()
    sources = {
        "__init__.py": "",
        "start.py": "import json\nimport beside\nfrom thing import one\nimport thing.two\n",
        "one.py": "def f():\n    from thing.three import name\n",
        "two.py": "import thing.start\n",
        "three.py": "name = 1\n",
        "four.py": "",
    }
    for name, text in sources.items():
        (package / name).write_text(text, encoding="utf-8")
    (tmp_path / "beside.py").touch()  # like other packages in pip's folder
    found = [file.name for file in imported_files(package, "start.py")]
    assert found == ["__init__.py", "one.py", "start.py", "three.py", "two.py"]
