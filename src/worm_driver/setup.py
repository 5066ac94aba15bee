# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "worm_driver"
EXECUTABLES: list[str] = [  # "executable = module:function", each installed in lib/NAME
    "virtual_robot = worm_driver.nodes.executables:virtual_robot",
    "driver_node = worm_driver.nodes.executables:driver_node",
    "tracker_node = worm_driver.nodes.executables:tracker_node",
    "calibrate = worm_driver.commands.calibrate:main",
    "bench_tests = worm_driver.commands.bench_tests:main",
    "markers = worm_driver.commands.markers:main",
    "calibrate_camera = worm_driver.commands.calibrate_camera:main",
    "track = worm_driver.commands.track:main",
]

setup(
    name=NAME,
    version="0.1.0",
    description="Driver, tracker and virtual robot of the worm: servos, power sensor, camera.",
    license="Apache-2.0",
    maintainer="The worm robot maintainers",
    maintainer_email="maintainers@worm.example",
    packages=find_packages(),
    package_data={NAME: ["config/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*"))),
        (f"share/{NAME}/udev", sorted(glob("udev/*"))),
        (f"share/{NAME}/systemd", sorted(glob("systemd/*"))),
        (f"share/{NAME}/security", sorted(glob("security/*.*"))),
        (f"share/{NAME}/security/policies", sorted(glob("security/policies/*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    extras_require={"test": ["pytest"]},  # makes colcon test use pytest
    entry_points={"console_scripts": EXECUTABLES},
)
