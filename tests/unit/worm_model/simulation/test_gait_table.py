# SPDX-License-Identifier: Apache-2.0
"""Tables of gaits as files."""

from pathlib import Path

import numpy as np
import pytest

from worm_model.errors import InputError
from worm_model.parameters import PAPER
from worm_model.simulation.gait_table import evaluate_table, read_gaits, write_table

HEADER = "stroke_m,frequency_Hz\n"


def test_a_written_table_can_be_read_again(tmp_path: Path):
    (tmp_path / "gaits.csv").write_text(HEADER + "0.07,0.4\n0.05,0.2\n")
    columns = read_gaits(tmp_path / "gaits.csv")
    overrides, table = evaluate_table(columns, PAPER)
    write_table(tmp_path / "results.csv", table, overrides, PAPER)
    again = read_gaits(tmp_path / "results.csv")
    for name, values in columns.items():
        np.testing.assert_array_equal(again[name], values)
    np.testing.assert_allclose(again["speed_m_s"], table.speed, rtol=1e-12)
    np.testing.assert_allclose(again["groove_phase_m"], table.groove_phase, atol=1e-9)


def test_an_error_names_the_line_of_the_file(tmp_path: Path):
    (tmp_path / "gaits.csv").write_text(HEADER + "\n0.07,0.4\n\n0.05,fast\n")
    with pytest.raises(InputError, match=r"line 5, column frequency_Hz.*fast"):
        read_gaits(tmp_path / "gaits.csv")
