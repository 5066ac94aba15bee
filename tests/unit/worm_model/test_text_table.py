# SPDX-License-Identifier: Apache-2.0
from worm_model.text_table import labelled, text_table


def test_numbers_stand_to_the_right_and_names_to_the_left():
    rows = [("gait", "speed", "n"), ("a", "10.00 mm/s", "2"), ("cruise", "-5.0 mm/s", "")]
    heads, first, second = text_table(rows).splitlines()
    assert heads == "gait         speed  n"
    assert first == "a       10.00 mm/s  2"
    assert second == "cruise   -5.0 mm/s"


def test_a_table_may_have_heads_alone():
    assert text_table([("gait", "speed")]) == "gait  speed"


def test_labelled_values_begin_in_one_column():
    assert labelled({"speed": "3.46 mm/s", "cycles": 5}) == "speed   3.46 mm/s\ncycles  5"
    assert labelled({}) == ""
