# SPDX-License-Identifier: Apache-2.0
"""Selection of the topics to record."""

from __future__ import annotations

import re
from dataclasses import dataclass

from worm_model.bags.formats.bag_errors import BagError


@dataclass(frozen=True)
class TopicSelection:
    """Topics selected by name, by regular expression, or all.

    Attributes:
        names: full topic names, always included.
        everything: include all topics that are not hidden.
        regex: pattern of further topics that are not hidden, searched for in the full name; empty: none.
        exclude: pattern of topics that `everything` and `regex` do not include, searched for like `regex`; empty: none.
    """

    names: frozenset[str] = frozenset()
    everything: bool = False
    regex: str = ""
    exclude: str = ""

    def __post_init__(self) -> None:
        if not (self.names or self.everything or self.regex):
            raise BagError("no topics: name some, or give --regex or --all")
        for pattern in (self.regex, self.exclude):
            try:
                re.compile(pattern)
            except re.error as error:
                raise BagError(f"{pattern!r} is not a regular expression: {error}") from None

    def takes(self, topic: str) -> bool:
        """Return True if a topic with this full name is recorded."""
        if topic in self.names:
            return True
        if any(part.startswith("_") for part in topic.split("/")):
            return False  # hidden topics, such as an action's feedback
        if self.exclude and re.search(self.exclude, topic):
            return False
        return self.everything or bool(self.regex and re.search(self.regex, topic))
