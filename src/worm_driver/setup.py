# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python) and by pip; see src/worm_msgs/setup.py."""

import sys
from glob import glob
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "worm_driver"
EXECUTABLES: list[str] = [  # "executable = module:function"
    "virtual_robot = worm_driver.nodes.executables:virtual_robot",
    "driver_node = worm_driver.nodes.executables:driver_node",
    "tracker_node = worm_driver.nodes.executables:tracker_node",
    "calibrate = worm_driver.commands.calibrate:main",
    "check = worm_driver.commands.check:main",
    "setup_servo = worm_driver.commands.setup_servo:main",
    "bench_tests = worm_driver.commands.bench_tests:main",
    "markers = worm_driver.commands.markers:main",
    "calibrate_camera = worm_driver.commands.calibrate_camera:main",
    "track = worm_driver.commands.track:main",
]
NEEDED = [
    "worm_msgs",
    "dynamixel-sdk>=4.0.5",
    "matplotlib>=3.6",
    "numpy>=1.26",
    "opencv-python-headless>=4.7",
    "pyserial>=3.5",
    "PyYAML>=6",
    "smbus2>=0.4",
]
IS_WHEEL = "setuptools.build_meta" in sys.modules

package = ElementTree.parse("package.xml")
maintainer = package.find("maintainer")
with TemporaryDirectory() as scratch:
    build = {"build": {"build_base": scratch}, "egg_info": {"egg_base": scratch}}
    setup(
        name=NAME,
        version=package.findtext("version"),
        description=package.findtext("description"),
        license=package.findtext("license"),
        maintainer=maintainer.text,
        maintainer_email=maintainer.get("email"),
        packages=find_packages(),
        package_data={NAME: ["py.typed", "config/*"]},
        python_requires=">=3.11",
        install_requires=NEEDED,
        extras_require={"test": ["pytest"]},
        entry_points={"worm.commands" if IS_WHEEL else "console_scripts": EXECUTABLES},
        options=build if IS_WHEEL else {},
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
    )
