# SPDX-License-Identifier: Apache-2.0
"""What takes minutes and goes on beside all else: a search of the optimizer, and an identification."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from worm_model.errors import InputError
from worm_model.parameters import load_parameters
from worm_optimizer.console import page_actions
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.robot_worker import Notice
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.orders import FrontOrder, ScanOrder, SearchResult


class Studies:
    """One search and one identification at a time, whatever page has begun them.

    Attributes:
        scan: the last margin scan, None before the first.
        identifying: how far an identification is, empty: none goes on.
        identified: the name of the parameter file that was identified last, empty: none.
        started: the parameter file that the console was started with, empty: the paper's values.
    """

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._goal: SearchGoal | None = None
        self._doing = ""
        self._task: asyncio.Task[None] | None = None
        self.scan: SearchResult | None = None
        self.identifying = ""
        self.identified = ""
        self.started = hub.parameter_file

    # --- a search --------------------------------------------------------------------------------

    @property
    def searching(self) -> str:
        """The search that goes on, empty: none."""
        return self._doing

    def search(self, order: ScanOrder | FrontOrder) -> bool:
        """Have the optimizer begin; false where something else is done."""
        scans = isinstance(order, ScanOrder)

        def begin(node: OperatorNode) -> str:
            if self._goal is not None:
                self._goal.close()
            self._goal = node.search(order, self._take)
            self._doing = "margin scan" if scans else "optimisation"
            return f"the {self._doing} has begun"

        return not self._doing and self._hub.worker.ask("asking the optimizer", begin)

    def _take(self, result: SearchResult) -> None:
        """Comes from the worker's thread."""
        doing, self._doing = self._doing, ""
        if result.margins:
            self.scan = result
        elif result.success:
            self._hub.fronts.clear()  # what was read is not what is answered any more
        self._hub.words.append(Notice(f"{doing}: {result.message}", good=result.success))

    # --- an identification -----------------------------------------------------------------------

    def identify(self, names: Sequence[str]) -> bool:
        """Begin with some bags; false where one goes on already."""
        if self.identifying:
            return False
        self.identifying = "identification"
        self._task = asyncio.create_task(self._identify(names))
        return True

    def cancel_identification(self) -> None:
        """End its process."""
        if self._task is not None:
            self._task.cancel()

    async def _identify(self, names: Sequence[str]) -> None:
        hub = self._hub
        try:
            made = await hub.shelf.identify(names, hub.parameter_file, self._note)
        except InputError as error:
            hub.words.append(Notice(f"identification: {error}", good=False))
        except asyncio.CancelledError:
            hub.words.append(Notice("identification: cancelled"))
        else:
            self.identified = made
            hub.words.append(Notice(f"identification: {made} is written, its report beside it"))
        finally:
            self.identifying = ""

    def _note(self, line: str) -> None:
        self.identifying = f"identification, {line}"

    # --- its parameter file ----------------------------------------------------------------------

    def take_over(self, file: str) -> bool:
        """Have twin and optimizer take a parameter file, empty for the paper's values.

        False where something else is done. Raises `InputError`.
        """
        hub, parameters = self._hub, load_parameters(file)

        def take(node: OperatorNode) -> str:
            said = page_actions.take_parameters(node, file)
            hub.parameters, hub.parameter_file = parameters, file
            hub.fronts.clear()
            return said

        return hub.worker.ask("taking the parameters over", take)
