# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python) and by pip; see src/worm_msgs/setup.py."""

import sys
from glob import glob
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "worm_optimizer"
EXECUTABLES: list[str] = [  # "executable = module:function"
    "optimizer_node = worm_optimizer.nodes.executables:optimizer_node",
    "optimize = worm_optimizer.commands.optimize:main",
    "scan_margin = worm_optimizer.commands.scan_margin:main",
    "request = worm_optimizer.commands.request:main",
    "tune = worm_optimizer.commands.tune:main",
    "demo = worm_optimizer.nodes.executables:demo",
    "report = worm_optimizer.commands.report:main",
    "start = worm_optimizer.nodes.executables:start",
    "operate = worm_optimizer.nodes.executables:operate",
    "campaign = worm_optimizer.nodes.executables:campaign",
    "console = worm_optimizer.nodes.executables:console",
    "study = worm_optimizer.commands.study:main",
    "capability = worm_optimizer.commands.capability:main",
]
NEEDED = [
    "worm_model",
    "worm_msgs",
    "jinja2>=3.1",
    "matplotlib>=3.6",
    "numpy>=1.26",
    "pymoo>=0.6.1",
    "scipy>=1.11",
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
        package_data={NAME: ["py.typed", "config/*", "report/*.jinja"]},
        python_requires=">=3.11",
        install_requires=NEEDED,
        extras_require={
            "console": ["nicegui>=3"],
            "study": ["distributed", "xarray"],
            "test": ["pytest"],  # because of it, colcon test runs pytest
        },
        entry_points={"worm.commands" if IS_WHEEL else "console_scripts": EXECUTABLES},
        options=build if IS_WHEEL else {},
        data_files=[
            ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
            (f"share/{NAME}", ["package.xml"]),
            (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*.yaml"))),
            (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        ],
    )
