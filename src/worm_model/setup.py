# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "worm_model"
EXECUTABLES: list[str] = [  # "executable = module:function", each is installed in lib/NAME
    "evaluate_gait = worm_model.commands.evaluate_gait:main",
    "simulate = worm_model.commands.simulate:main",
    "phase_map = worm_model.commands.phase_map:main",
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
    "watch = worm_model.nodes.executables:watch",
]
# Dependencies that pip installs without rosdep, for example for a worker of a study; pyproject.toml pins versions.
NEEDED = ["numpy", "scipy", "numba", "PyYAML", "matplotlib", "pillow", "mcap", "rosbags", "pyarrow"]

setup(
    name=NAME,
    version="0.1.0",
    description="Exact simulator, digital twin and identification of the worm.",
    license="Apache-2.0",
    maintainer="The worm robot maintainers",
    maintainer_email="maintainers@worm.example",
    packages=find_packages(),
    package_data={NAME: ["config/*"]},
    install_requires=NEEDED,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*"))),
        (f"share/{NAME}/rviz", sorted(glob("rviz/*"))),
        (f"share/{NAME}/urdf", sorted(glob("urdf/*"))),
        (f"share/{NAME}/foxglove", sorted(glob("foxglove/*"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    extras_require={"test": ["pytest"]},  # colcon test runs pytest because of this entry
    entry_points={"console_scripts": EXECUTABLES},
)
