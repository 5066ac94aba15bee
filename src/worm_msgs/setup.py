# SPDX-License-Identifier: Apache-2.0
"""Package definition for pip, for computers without ROS: the tables and helpers in plain Python, no messages.

colcon builds this package with CMake, by package.xml.
"""

from setuptools import setup

setup(
    name="worm_msgs",
    version="0.1.0",
    description="Tables that the packages of the worm robot share.",
    license="Apache-2.0",
    packages=["worm_msgs"],
)
