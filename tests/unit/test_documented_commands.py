# SPDX-License-Identifier: Apache-2.0
"""Every command of the documentation exists and its arguments parse; the fast ones are run."""

import argparse
import importlib
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from documented_commands import PACKAGE_OF, PAGES, ROOT, Command, commands, entry_points
from lab_files import write_bench_tests, write_lab
from recorded_run import simulated_run, write_bag
from unrendered import leave_runs_unrendered

COMMANDS = commands()
ENTRY_POINTS = entry_points()
EXECUTABLE_COMMANDS = [command for command in COMMANDS if command.executable]
SMALL_FRONT = ("--samples", "20", "--frequencies", "0.15", "0.15")
# Executables that only read and write files, with arguments that shorten those that take longer than seconds.
CHEAP: dict[tuple[str, str], tuple[str, ...]] = {
    **{
        ("worm_model", name): ()
        for name in (
            *("evaluate_gait", "export", "health", "identify", "import_lab"),
            *("bags", "margin", "recover", "replay", "simulate"),
        )
    },
    ("worm_optimizer", "optimize"): SMALL_FRONT,
    ("worm_optimizer", "report"): ("--without-front",),
    ("worm_optimizer", "capability"): SMALL_FRONT,
    ("worm_optimizer", "request"): SMALL_FRONT,
    ("worm_optimizer", "scan_margin"): ("--lowest", "0.0033", "--highest", "0.0036"),
}
NODES = {  # executables whose only arguments are those of ROS
    ("worm_driver", "driver_node"),
    ("worm_driver", "tracker_node"),
    ("worm_model", "twin_node"),
    ("worm_optimizer", "optimizer_node"),
}
LINK = re.compile(r"\]\(([^)#\s]*)(?:#([^)\s]*))?\)")


def subcommands() -> set[str]:
    """Return the commands of the script worm that are no executables."""
    script = (ROOT / "worm").read_text(encoding="utf-8")
    named = re.search(r"^commands=\((.*)\)$", script, re.MULTILINE)
    assert named
    return set(named[1].split()) - {"$(executables)"}


@pytest.fixture(autouse=True)
def _ctrl_c() -> Iterator[None]:
    """Restore the handler of Ctrl-C: a node leaves it to the system while it loads."""
    before = signal.getsignal(signal.SIGINT)
    yield
    signal.signal(signal.SIGINT, before)


def run(command: Command) -> int | None:
    """Call the function of a command."""
    module, function = ENTRY_POINTS[command.executable].split(":")
    return getattr(importlib.import_module(module), function)()


def filled(shown: str) -> str:
    """Return a number in place of a placeholder for one."""
    return "1" if shown in {"N", "M", "S", "HZ", "X", "MPS", "W"} else shown


def test_each_command_exists_with_its_benchmarks_and_paths():
    assert {"demo", "test", "build"} <= {command.parts[1] for command in COMMANDS}
    for command in COMMANDS:
        program, name, *arguments = command.parts
        assert program != "./worm" or name in {*subcommands(), *PACKAGE_OF, "--version"}, command
        assert not command.executable or command.executable in ENTRY_POINTS, command
        for shown in arguments:
            if name == "bench":
                assert shown[0] == "-" or (ROOT / "benchmarks" / f"{shown}.py").exists(), command
            if name == "test" and shown.startswith("tests"):
                assert (ROOT / shown).exists(), command


def test_each_named_command_of_the_script_is_carried_out_and_explained():
    script = (ROOT / "worm").read_text(encoding="utf-8")
    cases = set(re.findall(r"^  ([a-z]+)(?: \|.*?)?\) ", script, re.MULTILINE))
    usage = script.split("USAGE")[1]
    assert subcommands() == cases - {"wheels", "jazzy"} - set(PACKAGE_OF)
    assert {name for name in subcommands() if f"\n  {name} " not in usage} == set()


def called(*command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command in the folder of the workspace."""
    return subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


worm = partial(called, "./worm")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("dmeo",), ("dmeo", "demo")),
        (("help", "campain"), ("campain", "campaign")),
        (("xyzzy",), ("xyzzy",)),
    ],
)
def test_an_unknown_command_is_one_line_with_the_nearest(arguments: tuple[str, ...], named):
    done = worm(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert all(name in done.stderr for name in named)
    assert ("did you mean" in done.stderr) == (len(named) == 2)


def test_the_script_has_a_version_and_help():
    manifest = (ROOT / "src/worm_model/package.xml").read_text(encoding="utf-8")
    number = re.search("<version>(.*)</version>", manifest)
    assert number
    assert worm("--version").stdout.split()[:2] == ["worm", number[1]]
    assert worm("help").stdout == worm("--help").stdout
    assert "PYTEST" in worm("help", "test").stdout


def test_run_lists_the_executables_of_a_package():
    executables = [name for package, name in ENTRY_POINTS if package == "worm_model"]
    assert worm("run", "worm_model").stdout.split() == sorted(executables)
    wrong = worm("run", "worm_model", "simulat")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "simulate" in wrong.stderr


class Parsed(BaseException):
    """Raised instead of the action of a command, after its arguments were parsed."""


def test_the_arguments_of_each_command_parse(monkeypatch: pytest.MonkeyPatch):
    parse = argparse.ArgumentParser.parse_args

    def parse_and_leave(parser: argparse.ArgumentParser, *given: object) -> None:
        parse(parser, *given)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_and_leave)
    for command in EXECUTABLE_COMMANDS:
        if command.executable in NODES:
            assert not command.arguments, f"a node takes nothing but ROS arguments: {command}"
            continue
        arguments = [filled(shown) for shown in command.arguments]
        monkeypatch.setattr(sys, "argv", [command.executable[1], *arguments])
        with pytest.raises(SystemExit if "--help" in arguments else Parsed):
            run(command)


def prepared(shown: str, before: str, folder: Path) -> None:
    """Create the file that a command reads; commands create the files after --output and the like themselves."""
    path = folder / shown
    if before in {"--output", "--report", "--figure"} or path.exists():
        return
    if shown == "BAG" or shown.startswith("bags/"):
        seed = len(list(folder.glob("bags/*")))
        write_bag(path, simulated_run(5, seed))
    elif shown == "FOLDER":
        write_lab(path)
    elif shown.startswith("FOLDER/"):
        write_lab(path.parent, path.name)
    elif before == "--limits-from":
        path.write_bytes((ROOT / "src/worm_driver/config/driver.yaml").read_bytes())
    elif shown.endswith(".yaml"):
        path.write_text("gain: 0.86\nintervals: {gain: [0.85, 0.87]}\n")
    elif shown.endswith(".csv"):
        write_bench_tests(folder)


def runnable() -> list:
    """Return each command that `test_it_runs` runs, on whichever page; all but the first of an executable at night."""
    found, first = [], set()
    for command in EXECUTABLE_COMMANDS:
        name = command.executable
        if name in CHEAP and not any("../" in shown for shown in command.parts):
            marks = [pytest.mark.night] if name in first else []
            if command.parts not in {case.values[0].parts for case in found}:
                found.append(pytest.param(command, marks=marks, id=str(command)))
            first.add(name)
    return found


@pytest.mark.parametrize("command", runnable())
def test_it_runs(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    arguments = [shown.replace("/tmp/", f"{tmp_path}/") for shown in command.arguments]
    for before, shown in pairwise(["", *arguments]):
        prepared(shown, before, tmp_path)
    if command.parts == ("./worm", "report") or command.parts[-1] == "bags":  # of all recordings
        prepared("bags/demo_1", "", tmp_path)
    if command.executable == ("worm_model", "import_lab"):  # which reads one run of a lab
        arguments = ["FOLDER/run_01" if shown == "FOLDER" else shown for shown in arguments]
    arguments += CHEAP[command.executable]
    leave_runs_unrendered(monkeypatch)
    monkeypatch.setattr(sys, "argv", [command.executable[1], *arguments])
    assert run(command) == 0


def test_each_is_run_here_or_by_a_test_of_its_name():
    files = {f"{path.stem}_" for path in (ROOT / "tests").rglob("test_*.py")}
    others = {name for _, name in set(ENTRY_POINTS) - set(CHEAP)}
    unnamed = {n for n in others if not any(file.startswith(f"test_{n}_") for file in files)}
    # tested in test_camera_commands.py and test_driver.py
    assert unnamed == {"calibrate_camera", "markers", "track", "driver_node"}


@pytest.mark.night
@pytest.mark.parametrize(
    "command",
    [c for c in COMMANDS if c.parts[:3] == ("./worm", "shell", "-c") or "--help" in c.parts],
    ids=str,
)
def test_it_runs_in_the_built_workspace(command: Command):
    done = called(*command.parts)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.night
def test_the_reference_of_the_packages_is_built(tmp_path: Path):
    done = worm("docs", str(tmp_path / "docs"), WORM_COARSE_PICTURES="1")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{tmp_path}/docs/index.html\n"
    drawn = {path.name for path in (tmp_path / "docs" / "pictures").iterdir()}
    assert drawn == {path.name for path in (ROOT / "docs/figures/model").iterdir()}
    for module in ("worm_driver/virtual_robot/offline_run", "worm_model/gait"):
        assert (tmp_path / "docs" / f"{module}.html").exists()
    assert not (tmp_path / "docs" / "worm_driver" / "servos").exists()  # internal names
    page = (tmp_path / "docs" / "worm_model" / "simulation" / "simulator.html").read_text("utf-8")
    assert 'id="evaluate_gait"' in page


def test_a_benchmark_runs():
    benchmark = sys.executable, "-m", "benchmarks", "simulator_accuracy"
    done = called(*benchmark, WORM_BENCH_CASES="2")
    assert done.returncode == 0, done.stderr
    machine, _, title, *rows = done.stdout.splitlines()
    assert "cores, load" in machine
    assert title.startswith("simulator_accuracy: ")
    assert rows


def test_the_page_of_benchmarks_names_each():
    titled = [p.stem for p in (ROOT / "benchmarks").glob("*.py") if "\nTITLE" in p.read_text()]
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert titled
    assert [name for name in sorted(titled) if f"| `{name}` |" not in page] == []


def test_the_readme_names_each_executable_and_its_package():
    rows = re.findall(
        r"^\| (`.*`) \| (worm_\w+) \|",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.MULTILINE,
    )
    named = [(package, name) for names, package in rows for name in re.findall(r"`(\w+)`", names)]
    assert sorted(named) == sorted(ENTRY_POINTS)


def test_the_table_of_pages_has_every_page():
    table = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert sorted(page for page in pages if f"]({page})" not in table) == []


def test_launch_arguments_exist():
    system = yaml.safe_load((ROOT / "src/worm_optimizer/config/system.yaml").read_text())
    for command in COMMANDS:
        if command.parts[:2] == ("ros2", "launch"):
            package, file, *arguments = command.parts[2:]
            own = (ROOT / "src" / package / "launch" / file).read_text()
            known = {*re.findall(r'"(\w+)"', own), *system["settings"]}
            assert {argument.split(":=")[0] for argument in arguments} <= known


def anchors_of(page: Path) -> set[str]:
    """Return the anchors of a page's headings as GitHub makes them: lower case, hyphens for spaces, no other signs."""
    text = re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8"))
    found: Counter[str] = Counter()
    anchors = set()
    for heading in re.findall(r"^#+ +(.*?) *#*$", text, re.MULTILINE):
        anchor = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        anchors.add(f"{anchor}-{found[anchor]}" if found[anchor] else anchor)
        found[anchor] += 1
    return anchors


def test_the_links_of_the_pages_lead_somewhere():
    lost = []
    for page in PAGES:
        for link, anchor in LINK.findall(page.read_text(encoding="utf-8")):
            target = (page.parent / link) if link else page
            if "://" in link or link.startswith("mailto:"):
                continue
            if not target.exists() or (anchor and anchor not in anchors_of(target)):
                lost.append(f"{page.name}: {link}#{anchor}")
    assert lost == []
