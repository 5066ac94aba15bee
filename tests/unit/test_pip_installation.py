# SPDX-License-Identifier: Apache-2.0
"""Installation with pip: declared dependencies, versions, and the researcher's path in an environment without ROS."""

import ast
import os
import subprocess
import sys
from distutils.core import run_setup
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from worm_model.identification.report.identification_report import VERSION
from worm_msgs.worm_command import is_of_ros

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("worm_msgs", "worm_driver", "worm_model", "worm_optimizer")
# Imported module and distribution that installs it, if their names differ
DISTRIBUTIONS = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "serial": "pyserial",
    "yaml": "pyyaml",
    "dynamixel_sdk": "dynamixel-sdk",
    "pydantic_core": "pydantic",
    "markupsafe": "jinja2",
    "fastapi": "nicegui",
    "starlette": "nicegui",
}


def imported(package: str) -> set[str]:
    """Return the distributions that a package imports, also inside functions, without those of ROS."""
    names = set()
    for file in (ROOT / "src" / package / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(str(node.module))
    tops = {name.partition(".")[0] for name in names} - set(sys.stdlib_module_names) - {package}
    return {DISTRIBUTIONS.get(t, t) for t in tops if t in PACKAGES or not is_of_ros(t)}


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_requires_what_it_imports(package, monkeypatch):
    monkeypatch.chdir(ROOT / "src" / package)
    declared = run_setup("setup.py", stop_after="init")
    extras = {k: v for k, v in (declared.extras_require or {}).items() if k != "test"}
    required = [*declared.install_requires, *(name for names in extras.values() for name in names)]
    assert {name.partition(">=")[0].lower() for name in required} == imported(package)


def test_all_state_one_version():
    files = [ElementTree.parse(ROOT / "src" / name / "package.xml") for name in PACKAGES]
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))["version"]
    assert {file.findtext("version") for file in files} == {cited} == {VERSION}


def test_the_first_use_says_that_it_compiles(tmp_path: Path):
    """Without ``./worm build``, the first command computes nothing for a minute."""

    def imported_kernel() -> str:
        return subprocess.run(
            [sys.executable, "-c", "import worm_model.simulation.kernel"],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        ).stderr

    assert "worm_model.simulation.kernel" in imported_kernel()
    (folder,) = tmp_path.iterdir()
    (folder / "code.nbc").touch()
    assert imported_kernel() == ""


@pytest.fixture(scope="module")
def worm(tmp_path_factory):
    """Return a function that runs ``worm`` of wheels in an empty folder, and returns status, output and errors."""
    folder = tmp_path_factory.mktemp("pip")
    uv = Path(sys.executable).with_name("uv")
    if not uv.exists():
        pytest.skip("uv is not installed, as ROS is not from wheels")
    environment = {
        k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "AMENT_PREFIX_PATH")
    }

    def run(*command):
        place = folder / "empty"
        place.mkdir(exist_ok=True)
        return subprocess.run(
            command, cwd=place, env=environment, capture_output=True, text=True, check=False
        )

    before = run("git", "-C", ROOT, "status", "--short", "--ignored", "src").stdout
    sources = [ROOT / "src" / name for name in PACKAGES]
    run(uv, "venv", "--python", sys.executable, folder / "venv")
    installed = run(uv, "pip", "install", "--python", folder / "venv/bin/python", *sources)
    if installed.returncode:
        offline = "connect" in installed.stderr or "fetch" in installed.stderr
        (pytest.skip if offline else pytest.fail)(installed.stderr)
    assert run("git", "-C", ROOT, "status", "--short", "--ignored", "src").stdout == before
    assert {
        path.name
        for path in (folder / "venv/bin").glob("*")
        if path.name in ("play", "record", "worm")
    } == {"worm"}
    return lambda *arguments: run(folder / "venv/bin/worm", *map(str, arguments))


@pytest.mark.night
@pytest.mark.parametrize(
    "arguments",
    [
        ("replay", ROOT / "bags/forward"),
        ("margin", ROOT / "bags/forward"),
        ("identify", ROOT / "bags/forward", ROOT / "bags/reverse", "--output", "robot.yaml"),
        ("optimize", "--strokes", 0.06, 0.08, "--frequencies", 0.2, 0.2, "--margin", 0.002, "--samples", 5),
        ("report", ROOT / "bags/forward", "--without-front", "--output", "report"),
    ],
    ids=lambda arguments: arguments[0],
)  # fmt: skip
def test_a_researcher_needs_neither_ros_nor_this_checkout(worm, arguments):
    done = worm(*arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.night
def test_a_command_that_needs_ros_says_so_in_a_line(worm):
    done = worm("record")
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "ROS" in done.stderr
