# SPDX-License-Identifier: Apache-2.0
"""Makes the results that come with the package anew: ``python -m worm_optimizer.search.shipped``.

Their names are the hashes of what they follow from, the code included: after a change to it they are out of date, which
a test tells, and nobody finds them.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from worm_model.gait import FORWARD
from worm_model.parameters import ParameterFile
from worm_optimizer.search.cache import SHIPPED, Cache
from worm_optimizer.search.front import make_front
from worm_optimizer.search.search_settings import settings_of


def make(folder: Path) -> None:
    """Computes scan and fronts of the paper's parameters under the default settings into a folder."""
    make_front(ParameterFile(), settings_of({}), FORWARD, Cache.at(folder), lambda _progress: None)


def main() -> None:
    """Replaces what is shipped."""
    with TemporaryDirectory() as folder:
        make(Path(folder))
        shutil.rmtree(SHIPPED, ignore_errors=True)
        SHIPPED.mkdir()
        for file in sorted(Path(folder).glob("*.json")):
            shutil.copyfile(file, SHIPPED / file.name)
            sys.stderr.write(f"{SHIPPED / file.name}\n")


if __name__ == "__main__":
    main()
