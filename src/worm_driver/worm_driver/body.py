# SPDX-License-Identifier: Apache-2.0
"""Parameters of the model that the driver needs, and their file."""

import math
from dataclasses import dataclass
from pathlib import Path

from worm_driver.errors import ConfigurationError
from worm_msgs.yaml_file import read_yaml


@dataclass(frozen=True)
class Body:
    """Parameters of the model that the driver needs, by the keys of the parameter file. The paper's values by default.

    Attributes:
        rear_mass, front_mass: masses of the modules, kg.
        initial_length: initial length L0, m.
        pitch: distance between two grooves, m.
    """

    rear_mass: float = 0.429
    front_mass: float = 0.429
    initial_length: float = 0.2952
    pitch: float = 0.0173

    @property
    def mass(self) -> float:
        """Mass of the whole robot, kg."""
        return self.rear_mass + self.front_mass


def load_body(path: str) -> Body:
    """Return the body's parameters from a parameter file.

    An empty path and missing keys stand for the paper's values.

    Raises:
        ConfigurationError: The file cannot be read, or a value is not a positive number.
    """
    if not path:
        return Body()
    content = read_yaml(Path(path), ConfigurationError)
    if not isinstance(content, dict):
        raise ConfigurationError(f"parameter file {path} holds no keys")
    values = {name: content[name] for name in Body.__dataclass_fields__ if name in content}
    for name, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigurationError(f"{name} in {path} is {value!r}, not a number")
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{name} in {path} is {value!r}, it must be positive")
    return Body(**values)
