# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python) and by pip; see src/worm_msgs/setup.py."""

import sys
from glob import glob
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from setuptools import find_packages, setup

NAME = "worm_model"
EXECUTABLES: list[str] = [  # "executable = module:function"
    "evaluate_gait = worm_model.commands.evaluate_gait:main",
    "simulate = worm_model.commands.simulate:main",
    "export = worm_model.commands.export:main",
    "identify = worm_model.commands.identify:main",
    "import_lab = worm_model.commands.import_lab:main",
    "bags = worm_model.commands.bags:main",
    "recover = worm_model.commands.recover:main",
    "record = worm_model.nodes.executables:record",
    "play = worm_model.nodes.executables:play",
    "replay = worm_model.commands.replay:main",
    "twin_node = worm_model.nodes.executables:twin_node",
    "health = worm_model.commands.health:main",
    "margin = worm_model.commands.margin:main",
]
NEEDED = [
    "worm_msgs",
    "apsw>=3.40",
    "matplotlib>=3.6",
    "mcap>=1.1",
    "numba>=0.58",
    "numpy>=1.26",
    "PyYAML>=6",
    "rosbags>=0.11",
    "scipy>=1.11",
    "zstandard>=0.22",
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
        package_data={NAME: ["py.typed"]},
        python_requires=">=3.11",
        install_requires=NEEDED,
        extras_require={"frames": ["pandas"], "parquet": ["pyarrow>=14"], "test": ["pytest"]},
        entry_points={"worm.commands" if IS_WHEEL else "console_scripts": EXECUTABLES},
        options=build if IS_WHEEL else {},
        data_files=[
            ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
            (f"share/{NAME}", ["package.xml"]),
            (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*"))),
            (f"share/{NAME}/rviz", sorted(glob("rviz/*"))),
            (f"share/{NAME}/urdf", sorted(glob("urdf/*"))),
            (f"share/{NAME}/foxglove", sorted(glob("foxglove/*"))),
            (f"share/{NAME}/plotjuggler", sorted(glob("plotjuggler/*"))),
            (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        ],
    )
