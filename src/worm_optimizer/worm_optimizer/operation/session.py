# SPDX-License-Identifier: Apache-2.0
"""What commands that bring the node graph up share: what they tell, and where their sockets and logs lie."""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from worm_model.analysis.run_metrics import RecordingError
from worm_optimizer.nodes.operator_node import OperatorError
from worm_optimizer.operation.processes import ProcessError

FAILURES = (ProcessError, OperatorError, RecordingError)


class Narrator:
    """Tells on standard error what goes on, and since when."""

    def __init__(self, program: str) -> None:
        self._program = program
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Tell one line."""
        elapsed = time.monotonic() - self._start
        print(f"{self._program}: {elapsed:5.1f} s  {text}", file=sys.stderr, flush=True)  # noqa: T201


@contextmanager
def work_folder(program: str) -> Iterator[Path]:
    """A folder for sockets, with a folder ``logs`` in it, which stays only after a failure."""
    folder = Path(tempfile.mkdtemp(prefix=f"worm_{program}_"))
    (folder / "logs").mkdir()
    try:
        yield folder
    except FAILURES:
        print(f"{program}: the logs of all nodes are in {folder / 'logs'}", file=sys.stderr)  # noqa: T201
        raise
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)
