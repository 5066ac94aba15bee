# SPDX-License-Identifier: Apache-2.0
"""Commands that README.md, CONTRIBUTING.md and docs/ show, as data for tests."""

import ast
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    path
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/**/*.md")))
    if path.exists()
]
BLOCK_LINE = re.compile(
    r"^(?: {4,}|\t)?(?:\$ )?((?:\./worm|ros2 (?:run|launch)) .*)$", re.MULTILINE
)
INLINE = re.compile(r"`((?:\./worm|ros2 (?:run|launch)) [^`\n]+)`")


def entry_points() -> dict[tuple[str, str], str]:
    """Return module and function (``module:function``) by package and executable, as declared in the setup.py files."""
    found = {}
    for setup in sorted((ROOT / "src").glob("*/setup.py")):
        for node in ast.walk(ast.parse(setup.read_text(encoding="utf-8"))):
            if isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "EXECUTABLES":
                for entry in ast.literal_eval(node.value):  # type: ignore[arg-type]
                    name, target = (part.strip() for part in entry.split("="))
                    found[setup.parent.name, name] = target
    return found


# Packages of the executables, which are subcommands of ./worm, too.
PACKAGE_OF = {name: package for package, name in entry_points()}


@dataclass(frozen=True)
class Command:
    """One command as shown: the page and the arguments, without comments and without brackets of optional parts."""

    page: str
    parts: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page}: {shlex.join(self.parts)}"

    @property
    def executable(self) -> tuple[str, str] | None:
        """Package and executable that the command runs, or None."""
        runs = self.parts[:2] in (("./worm", "run"), ("ros2", "run"))
        if runs and len(self.parts) >= 4 and self.parts[2] != "PACKAGE":
            return self.parts[2], self.parts[3]
        if self.parts[0] == "./worm" and self.parts[1] in PACKAGE_OF:
            return PACKAGE_OF[self.parts[1]], self.parts[1]
        return None

    @property
    def arguments(self) -> tuple[str, ...]:
        """Arguments of the executable, without those of ROS."""
        start = 2 if self.parts[1] in PACKAGE_OF else 4
        parts = self.parts[start:]
        return parts[: parts.index("--ros-args")] if "--ros-args" in parts else parts


def commands() -> list[Command]:
    """Return every command of every page, once."""
    found: dict[Command, None] = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for line in [*BLOCK_LINE.findall(text), *INLINE.findall(text)]:
            found[Command(str(page.relative_to(ROOT)), _split(line))] = None
    return list(found)


def _split(line: str) -> tuple[str, ...]:
    """Return the arguments as a shell splits them, up to a pipe or redirection, without brackets and dots."""
    parts = shlex.split(line.replace("…", " "), comments=True)
    for end in ("&", "|", "&&", ">", ";"):
        if end in parts:
            parts = parts[: parts.index(end)]
    return tuple(
        shell_part.strip("[]") for shell_part in parts if shell_part.strip("[]") not in ("", "...")
    )
