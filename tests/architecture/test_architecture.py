# SPDX-License-Identifier: Apache-2.0
"""Tables of the allowed imports, compared with the imports of each file."""

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Set
from fnmatch import fnmatch
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from worm_model.twin.core.memory import MEMORY

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(path for path in (ROOT / "src").glob("*/*/**/*.py") if path.parts[-2] != "launch")

LICENSE_LINE = "# SPDX-License-Identifier: Apache-2.0\n"

# Our packages that each package may import in addition to itself.
PACKAGES: dict[str, set[str]] = {
    "worm_msgs": set(),
    "worm_driver": {"worm_msgs"},
    "worm_model": {"worm_msgs"},
    "worm_optimizer": {"worm_model", "worm_msgs"},
}

# Libraries that only the files named here may import.
NODES = ["*/nodes/*.py"]
# Plain tables and readers that several packages share. They do not import ROS, although they are in the package of the
# messages.
SHARED = {
    f"worm_msgs.{name}"
    for name in (
        *("claim", "command_parser", "conditions", "driver_file", "gait", "input_error"),
        *("network", "parameter_rows", "robot_parameters", "ros_parameter_file", "servo_models"),
        *("settings_file", "yaml_file"),
    )
}
PROCESSES = [
    f"worm_msgs/{name}.py"
    for name in ("ros_process", "node_command", "parameter_rows", "qos", "goal_rejections")
]
CONFINED = {
    "rclpy": [*NODES, *PROCESSES],
    "rcl_interfaces": [*NODES, *PROCESSES],
    "worm_msgs": [*NODES, *PROCESSES],
    **{f"{name}_msgs": NODES for name in ("std", "sensor", "diagnostic", "lifecycle", "nav")},
    **{f"{name}_msgs": NODES for name in ("tf2", "visualization", "geometry")},
    **dict.fromkeys(("std_srvs", "builtin_interfaces"), NODES),
    "dynamixel_sdk": ["worm_driver/servos/servo_bus.py", "*/wire/packet.py"],
    "cv2": ["worm_driver/tracking/vision.py"],
    "smbus2": ["worm_driver/power/i2c.py"],
    "pymoo": ["worm_optimizer/search/nsga2.py"],
    "numba": ["worm_model/simulation/kernel/*.py"],
    "matplotlib": [
        "worm_driver/commands/markers.py",
        "*/analysis/*.py",
        "*_figure.py",
        "*_figures.py",
        "*_plots.py",
        "*/report/*.py",
    ],
    "pydantic": ["worm_msgs/settings_file.py"],
    "pydantic_core": ["worm_msgs/settings_file.py"],
    "jinja2": ["worm_optimizer/report/report_page.py"],
    "mcap": ["worm_model/bags/*.py"],
    "mcap_ros2": ["worm_model/bags/*.py"],
    "rosbags": ["worm_model/bags/*.py"],
    "pandas": ["worm_model/analysis/run_table.py"],
    "distributed": ["worm_optimizer/study/blocks.py"],
    "nicegui": ["worm_optimizer/console/*page*.py"],
    "fastapi": ["worm_optimizer/console/console_page.py"],
    "starlette": ["worm_optimizer/console/console_page.py"],
    "xarray": ["worm_optimizer/study/study_run.py"],
    **{name: [] for name in ("launch", "launch_ros", "domain_coordinator", "colcon_core")},
    **{name: [] for name in ("PIL", "dask", "torch")},
}

MOST_NAMES, LONG_IMPORTS = 6, 25

# Folders of its own package that a folder may import in addition to itself. Folders that are missing here may import
# any. Modules in no folder (parameters, gait, run, errors) may be imported by all folders.
SEAMS = {
    "worm_driver": {
        "servos": set(),
        "gait": {"power"},
        "power": set(),
        "control": {"gait", "power", "servos"},
        "tracking": {"control"},
    },
    "worm_model": {
        "simulation": set(),
        "bags": set(),
        "margin": {"simulation"},
        "twin": {"margin", "simulation"},
        "analysis": {"margin", "simulation", "twin"},
        "identification": {"analysis", "bags", "margin", "simulation"},
    },
    "worm_optimizer": {
        "evaluation": set(),
        "robustness": {"evaluation"},
        "search": {"evaluation", "robustness"},
        "report": {"evaluation", "search", "robustness"},
        "nodes": {"evaluation", "search", "robustness"},
        "operation": {"evaluation", "search", "robustness", "report", "nodes"},
        "console": {"evaluation", "search", "robustness", "report", "nodes", "operation"},
    },
}


def name_of(path: Path) -> str:
    """Return worm_model/bags.py for src/worm_model/worm_model/bags.py."""
    return str(path.relative_to(ROOT / "src").relative_to(path.relative_to(ROOT / "src").parts[0]))


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Return the line and the top-level package of each absolute import, including imports inside functions."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name.split(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.lineno, node.module.split(".")[0]


def confined_imports(path: Path) -> Iterator[tuple[int, str]]:
    """Return the same as `imports`, without the shared tables."""
    tree = tree_of(path)
    shared = {
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        and (node.module in SHARED or {f"{node.module}.{a.name}" for a in node.names} <= SHARED)
    }
    yield from ((line, library) for line, library in imports(path) if line not in shared)


def may_import(name: str, library: str) -> bool:
    patterns = CONFINED.get(library)
    return patterns is None or any(
        fnmatch(name, pattern) or fnmatch(Path(name).name, pattern) for pattern in patterns
    )


def test_packages_import_only_what_the_table_allows():
    wrong = [
        f"{path.relative_to(ROOT)}:{line} imports {library}"
        for path in SOURCES
        for package in [path.relative_to(ROOT / "src").parts[0]]
        for line, library in imports(path)
        if library.startswith("worm_") and library not in PACKAGES[package] | {package}
    ]
    assert wrong == []


def folders_imported(path: Path) -> Iterator[str]:
    """Return the folders of its own package that a file imports from, also inside functions."""
    package = path.relative_to(ROOT / "src").parts[0]
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{package}."):
            folder = str(node.module).split(".")[1]
            if (ROOT / "src" / package / package / folder).is_dir():
                yield folder


def test_folders_import_only_what_the_seams_allow():
    """Search and robustness do not import operation or report; the core does not import nodes or commands."""
    wrong = [
        f"{name} imports {folder}"
        for path in SOURCES
        for name in [name_of(path)]
        for package, own in [name.split("/")[:2]]
        if own in SEAMS.get(package, {})
        for folder in folders_imported(path)
        if folder not in SEAMS[package][own] | {own}
    ]
    assert wrong == []


def modules_imported(path: Path, modules: Set[str]) -> Iterator[str]:
    """Return the modules of the packages that a file imports, also inside functions."""
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.ImportFrom):
            parts = (f"{node.module}.{alias.name}" for alias in node.names)
            yield from {part if part in modules else str(node.module) for part in parts} & modules


def test_no_folders_import_each_other():
    """Neither directly nor through further folders, at any depth."""
    modules = {name_of(path).removesuffix(".py").replace("/", "."): path for path in SOURCES}
    folders = {
        folder: {
            imported.rpartition(".")[0]
            for module, path in modules.items()
            if module.rpartition(".")[0] == folder
            for imported in modules_imported(path, modules.keys())
        }
        - {folder}
        for folder in {module.rpartition(".")[0] for module in modules}
    }
    assert (
        len(list(TopologicalSorter(folders).static_order())) > 30
    )  # or a CycleError names the cycle


def test_a_module_of_which_many_names_are_needed_is_imported_itself():
    """The number of exceptions may only fall. Messages are imported by name."""
    long = [
        f"{name_of(path)}:{node.lineno}"
        for path in SOURCES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ImportFrom)
        and len(node.names) > MOST_NAMES
        and (node.module or "").startswith("worm_")
        and not (node.module or "").endswith(".msg")
    ]
    assert len(long) <= LONG_IMPORTS, long


def test_libraries_are_imported_only_where_they_belong():
    wrong = [
        f"{path.relative_to(ROOT)}:{line} imports {library}"
        for path in SOURCES
        for line, library in confined_imports(path)
        if not may_import(name_of(path), library)
    ]
    assert wrong == []


def test_every_process_with_ros_begins_and_ends_in_one_way():
    """Otherwise a process could be visible on the network, or its context could be shut down while it still works."""
    callers = {
        name_of(path) for path in SOURCES if "rclpy.init(" in path.read_text(encoding="utf-8")
    }
    assert callers == {"worm_msgs/ros_process.py"}


def test_product_code_does_not_use_the_reference_material():
    wrong = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in sorted((ROOT / "src").rglob("*"))
        if path.is_file() and path.suffix in {".py", ".yaml", ".xml", ".cfg", ".cmake", ".txt"}
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if "shared/" in line
    ]
    assert wrong == []


def test_every_python_file_names_its_license():
    files = [
        path
        for folder in ("src", "tests", "benchmarks")
        for path in sorted((ROOT / folder).rglob("*.py"))
    ]
    without = [
        str(path.relative_to(ROOT))
        for path in files
        if not path.read_text(encoding="utf-8").startswith(LICENSE_LINE)
    ]
    assert without == []


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_the_manifest_names_the_packages_that_are_imported(package: str):
    ros = {"rclpy", "ament_index_python", "rcl_interfaces", "std_srvs", "builtin_interfaces"}
    manifest = (ROOT / "src" / package / "package.xml").read_text(encoding="utf-8")
    imported = {
        library
        for path in SOURCES
        if path.relative_to(ROOT / "src").parts[0] == package
        for _, library in imports(path)
        if library in ros or library.endswith("_msgs") or library.startswith("worm_")
    }
    missing = [name for name in sorted(imported - {package}) if f">{name}<" not in manifest]
    assert missing == []


def test_the_core_runs_without_ros():
    """Importing the simulator must not import a middleware or a message."""
    code = (
        "import sys, worm_model.parameters, worm_model.gait, worm_model.simulation.actuation\n"
        "sys.exit(any(name.split('.')[0] == 'rclpy' or name.endswith('.msg') for name in sys.modules))"
    )
    folders = [str(ROOT / "src" / package) for package in ("worm_model", "worm_msgs")]
    environment = {"PYTHONPATH": os.pathsep.join(folders), "PATH": "/usr/bin:/bin"}
    assert subprocess.run([sys.executable, "-c", code], env=environment).returncode == 0


# Each package has a table of executables; `worm_model.gait` publishes the names of `worm_msgs.gait`.
SAME_NAMES = {"__init__", "executables", "gait"}
# Words of the whole project: one class each.
WORDS = ("Run", "Report", "ServoModel", "Health", "Snapshot")


def test_each_module_has_a_name_of_its_own():
    """Except that the module of a command has the name of the command."""
    names = [path.stem for path in SOURCES if path.parent.name != "commands"]
    assert {name for name in names if names.count(name) > 1} == SAME_NAMES


@pytest.mark.parametrize("word", WORDS)
def test_a_word_names_one_class(word: str):
    line = re.compile(rf"^class {word}\b", re.MULTILINE)
    assert len([path for path in SOURCES if line.search(path.read_text(encoding="utf-8"))]) == 1


def test_a_match_rejects_members_without_a_case():
    """Mypy rejects the `assert_never` of a match in which a member has no case."""
    open_ends = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in SOURCES
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Match) and ast.unparse(node.cases[-1].pattern) != "_"
    ]
    assert open_ends == []


def test_only_named_functions_change_the_record_of_the_twin():
    """Between two calls of the core, `begin_run` and `record_changes` do it; `stored_memory` fills a new one."""
    folder = ROOT / "src/worm_model/worm_model/twin"
    changes = {
        path.stem
        for path in folder.glob("*.py")
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
        if isinstance(node.slice, ast.Constant) and node.slice.value in MEMORY.names
    }
    assert changes == {"record_changes", "run_start", "stored_memory"}
