# SPDX-License-Identifier: Apache-2.0
"""The camera: rate, noise, occlusions, latency."""

import math
from dataclasses import replace
from itertools import pairwise
from random import Random

import pytest

from worm_driver.virtual_robot.virtual_robot import Tracker, VirtualRobot
from worm_driver.virtual_robot.virtual_settings import TrackerSettings

CLEAR = TrackerSettings(rate=30.0, noise=0.00015, occlusion_rate=0.0, occlusion=0.3, latency=0.0)


def watch(settings, seconds, seed=1):
    tracker = Tracker(settings, Random(seed))
    return [tracker.expose(index / 30, 0.1, 0.4) for index in range(round(seconds * 30))]


def test_noise_has_the_size_it_should_have():
    errors = [sample.rear_position - 0.1 for sample in watch(CLEAR, 100)]
    assert math.sqrt(sum(e * e for e in errors) / len(errors)) == pytest.approx(0.00015, rel=0.05)


def test_an_occlusion_hides_one_marker_for_its_time():
    samples = watch(replace(CLEAR, occlusion_rate=0.2), 200)
    hidden = [math.isnan(sample.rear_position) for sample in samples]
    starts = sum(now and not before for before, now in pairwise(hidden))
    assert starts == pytest.approx(0.2 * 200, rel=0.4)
    assert sum(hidden) / starts == pytest.approx(0.3 * 30, rel=0.25)
    both = sum(
        math.isnan(sample.rear_position) and math.isnan(sample.front_position) for sample in samples
    )
    assert both < 0.5 * sum(hidden)


def test_samples_come_after_their_latency_and_carry_the_exposures_time(settings):
    delayed = replace(settings, tracker=replace(settings.tracker, latency=0.1))
    robot = VirtualRobot(delayed)
    robot.advance(0.099)
    assert robot.take_samples(0.099) == []
    robot.advance(0.15)
    times = [sample.time for sample in robot.take_samples(0.15)]
    assert times == pytest.approx([0.001, 0.034], abs=1e-9)
