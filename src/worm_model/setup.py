# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "worm_model"
EXECUTABLES: list[str] = [  # "executable = module:function", each lands in lib/NAME
    "evaluate_gait = worm_model.evaluate_gait:main",
    "phase_map = worm_model.phase_map:main",
    "export = worm_model.export:main",
    "identify = worm_model.identify:main",
    "import_lab = worm_model.import_lab:main",
    "recover = worm_model.recover:main",
    "play = worm_model.play_node:main",
    "replay = worm_model.replay:main",
    "twin_node = worm_model.twin_node:main",
    "health = worm_model.health_command:main",
    "watch = worm_model.watch_node:main",
]

setup(
    name=NAME,
    version="0.1.0",
    description="Exact simulator, digital twin and identification of the worm.",
    license="Apache-2.0",
    maintainer="The worm robot maintainers",
    maintainer_email="maintainers@worm.invalid",
    packages=find_packages(),
    package_data={NAME: ["config/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*"))),
        (f"share/{NAME}/rviz", sorted(glob("rviz/*"))),
        (f"share/{NAME}/foxglove", sorted(glob("foxglove/*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    entry_points={"console_scripts": EXECUTABLES},
)
