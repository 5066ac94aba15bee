# SPDX-License-Identifier: Apache-2.0
"""Command that runs benchmarks: every module of this folder with a TITLE and a function run() -> list[Row]."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import pkgutil
import sys
from types import ModuleType

import benchmarks
from benchmarks.mixed_load import mixed_load
from benchmarks.report import machine, print_rows


def find_benchmarks() -> dict[str, ModuleType]:
    """Return the benchmarks by name, in alphabetical order."""
    names = sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__))
    modules = {
        name: importlib.import_module(f"benchmarks.{name}")
        for name in names
        if name not in ("__main__", "report")
    }
    return {name: module for name, module in modules.items() if hasattr(module, "TITLE")}


def main() -> int:
    """Entry point of ``./worm bench``."""
    known = find_benchmarks()
    listing = "\n".join(f"  {name:24} {module.TITLE}" for name, module in known.items())
    parser = argparse.ArgumentParser(
        prog="./worm bench",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="Ratios and rates, each measured in one run on this machine.",
        epilog=f"benchmarks:\n{listing}",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="which; default: all")
    parser.add_argument(
        "--busy",
        action="store_true",
        help="during other work: two demos, a loop that bursts, a writer that syncs 50 MB at a time",
    )
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in known]
    if unknown:
        parser.error(f"no benchmark {unknown[0]}; there are {', '.join(known)}")
    print(machine())
    load = " during other work" if options.busy else ""
    for name in options.names or known:
        print(f"{name}{load} …", file=sys.stderr, flush=True)
        with mixed_load() if options.busy else contextlib.nullcontext():
            rows = known[name].run()
        print_rows(f"{name}{load}: {known[name].TITLE}", rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
