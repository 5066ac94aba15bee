# SPDX-License-Identifier: Apache-2.0
"""Background work that takes minutes, for the tab Studies: searches of the optimizer, and identifications.

The studies of many robots or bags are another part of the program (`worm_optimizer.study`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from pathlib import Path

from worm_model.errors import InputError
from worm_model.parameters import load_parameters
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.robot_worker import Notice
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.robot_commands import FrontRequest, ScanRequest, SearchResult


class Studies:
    """Searches and identifications. All pages share them. At most one search and one identification run at a time.

    A search is a margin scan or the computation of a front.

    Attributes:
        scan: result of the latest margin scan; None before the first.
        identifying: progress of the present identification; empty if there is none.
        identified: name of the parameter file of the latest identification; empty before the first.
        initial_file: parameter file at the start of the console; empty: the paper's values.
    """

    def __init__(self, state: ConsoleState) -> None:
        self._state = state
        self._goal: SearchGoal | None = None
        self._search_name = ""
        self._task: asyncio.Task[None] | None = None
        self.scan: SearchResult | None = None
        self.identifying = ""
        self.identified = ""
        self.initial_file = state.parameter_file

    # --- a search --------------------------------------------------------------------------------

    @property
    def searching(self) -> str:
        """Name of the present search; empty if there is none."""
        return self._search_name

    def search(self, request: ScanRequest | FrontRequest) -> bool:
        """Start a search.

        Return False, and do nothing, if a search is under way or `RobotWorker.submit` accepts no command.
        """
        scans = isinstance(request, ScanRequest)

        def begin(node: OperatorNode) -> str:
            if self._goal is not None:
                self._goal.close()
            self._goal = node.search(request, self._store)
            self._search_name = "margin scan" if scans else "computation of the front"
            return f"the {self._search_name} has begun"

        return not self._search_name and self._state.worker.submit(
            "sending the request to the optimizer", begin
        )

    def _store(self, result: SearchResult) -> None:
        """Store a result. The command thread calls this."""
        name, self._search_name = self._search_name, ""
        if result.margins:
            self.scan = result
        elif result.success:
            self._state.fronts.clear()  # the optimizer has another front now
        self._state.notices.append(Notice(f"{name}: {result.message}", good=result.success))

    # --- an identification -----------------------------------------------------------------------

    def identify(self, names: Sequence[str]) -> bool:
        """Start an identification from bags. Return False, and do nothing, if one is under way."""
        if self.identifying:
            return False
        self.identifying = "identification"
        self._task = asyncio.create_task(self._identify(names))
        return True

    def cancel_identification(self) -> None:
        """Cancel the identification."""
        if self._task is not None:
            self._task.cancel()

    async def _identify(self, names: Sequence[str]) -> None:
        state = self._state
        try:
            made = await state.library.identify(names, state.parameter_file, self._note)
        except InputError as error:
            state.notices.append(Notice(f"identification: {error}", good=False))
        except asyncio.CancelledError:
            state.notices.append(Notice("identification: cancelled"))
        else:
            self.identified = made
            state.notices.append(Notice(f"identification: {made} and its report were written"))
        finally:
            self.identifying = ""

    def _note(self, line: str) -> None:
        self.identifying = f"identification, {line}"

    # --- parameters of twin and optimizer --------------------------------------------------------

    def set_parameter_file(self, file: str) -> bool:
        """Set the parameter file of twin and optimizer; empty for the paper's values.

        Return False, and do nothing, if `RobotWorker.submit` accepts no command. Raises `InputError` if the file is
        invalid.
        """
        state, parameters = self._state, load_parameters(file)

        def apply(node: OperatorNode) -> str:
            node.set_model_parameters({"parameter_file": file})
            state.parameters, state.parameter_file = parameters, file
            state.fronts.clear()
            return f"twin and optimizer use {Path(file).name or 'the paper’s values'}"

        return state.worker.submit("setting the parameters of twin and optimizer", apply)
