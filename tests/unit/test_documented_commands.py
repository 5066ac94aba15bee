# SPDX-License-Identifier: Apache-2.0
"""Every command of the documentation is real: it exists, its arguments parse, and the cheap ones are run."""

import argparse
import importlib
import re
import sys
from pathlib import Path

import pytest
import yaml
from documented_commands import PAGES, ROOT, Command, commands, entry_points
from recorded_run import simulated_run, write_bag

COMMANDS = commands()
ENTRY_POINTS = entry_points()
EXECUTABLE_COMMANDS = [command for command in COMMANDS if command.executable]
# What reads and writes files alone and is done in seconds.
CHEAP = {
    ("worm_model", name) for name in ("evaluate_gait", "export", "phase_map", "recover", "replay")
}
NODES = {  # whose only arguments are those of ROS
    ("worm_driver", "driver_node"),
    ("worm_model", "twin_node"),
    ("worm_optimizer", "optimizer_node"),
}
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")


def subcommands() -> set[str]:
    """What the script worm knows."""
    script = (ROOT / "worm").read_text(encoding="utf-8")
    return set(re.findall(r"^  ([a-z]+)\) ", script, re.MULTILINE))


def module_of(command: Command):
    """The module behind a command; skips where it needs a ROS that is not there."""
    try:
        return importlib.import_module(ENTRY_POINTS[command.executable])
    except ImportError as error:
        pytest.skip(f"cannot be imported here: {error}")


def filled(word: str) -> str:
    """A number in the place of a placeholder for one."""
    return "1" if word in {"N", "M", "S", "HZ", "X", "MPS", "W"} else word


def test_there_are_commands():
    assert {"demo", "test", "build"} <= {command.words[1] for command in COMMANDS}


@pytest.mark.parametrize("command", COMMANDS, ids=str)
def test_the_command_exists(command: Command):
    if command.words[0] == "./worm":
        assert command.words[1] in subcommands()
    if command.executable:
        assert command.executable in ENTRY_POINTS


class Parsed(BaseException):
    """Raised in the place of what a command does after its arguments were parsed."""


@pytest.mark.parametrize("command", EXECUTABLE_COMMANDS, ids=str)
def test_its_arguments_parse(command: Command, monkeypatch: pytest.MonkeyPatch):
    if command.executable in NODES:
        assert not command.arguments, "a node takes nothing but ROS arguments"
        return
    parse = argparse.ArgumentParser.parse_args

    def parse_and_leave(parser: argparse.ArgumentParser, *given: object) -> None:
        parse(parser, *given)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_and_leave)
    arguments = [filled(word) for word in command.arguments]
    monkeypatch.setattr(sys, "argv", [command.executable[1], *arguments])
    with pytest.raises(SystemExit if "--help" in arguments else Parsed):
        module_of(command).main()


@pytest.mark.parametrize(
    "command", [command for command in EXECUTABLE_COMMANDS if command.executable in CHEAP], ids=str
)
def test_it_runs(command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    arguments = [word.replace("/tmp/", f"{tmp_path}/") for word in command.arguments]
    for word in arguments:
        if word == "BAG" or word.startswith("bags/"):
            write_bag(tmp_path / word, simulated_run())
    monkeypatch.setattr(sys, "argv", [command.executable[1], *arguments])
    assert module_of(command).main() == 0


@pytest.mark.parametrize(
    "command", [c for c in COMMANDS if c.words[:2] == ("./worm", "bench")], ids=str
)
def test_benchmarks_exist(command: Command):
    for name in command.words[2:]:
        assert name.startswith("-") or (ROOT / "benchmarks" / f"{name}.py").exists()


def test_the_page_of_benchmarks_names_each():
    titled = [p.stem for p in (ROOT / "benchmarks").glob("*.py") if "\nTITLE" in p.read_text()]
    page = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    assert titled
    assert [name for name in sorted(titled) if f"| `{name}` |" not in page] == []


@pytest.mark.parametrize(
    "command", [c for c in COMMANDS if c.words[:2] == ("./worm", "test")], ids=str
)
def test_paths_of_tests_exist(command: Command):
    for word in command.words[2:]:
        assert not word.startswith("tests") or (ROOT / word).exists()


@pytest.mark.parametrize(
    "command", [c for c in COMMANDS if c.words[:2] == ("ros2", "launch")], ids=str
)
def test_launch_arguments_exist(command: Command):
    package, file, *arguments = command.words[2:]
    assert (ROOT / "src" / package / "launch" / file).exists()
    system = yaml.safe_load((ROOT / "src/worm_optimizer/config/system.yaml").read_text())
    known = {"mode", *system["settings"]}
    assert {argument.split(":=")[0] for argument in arguments} <= known


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_somewhere(page: Path):
    text = page.read_text(encoding="utf-8")
    local = [link for link in LINK.findall(text) if "://" not in link]
    assert [link for link in local if not (page.parent / link).exists()] == []
