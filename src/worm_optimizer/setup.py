# SPDX-License-Identifier: Apache-2.0
"""Package definition, read by colcon (ament_python)."""

from glob import glob

from setuptools import find_packages, setup

NAME = "worm_optimizer"
EXECUTABLES: list[str] = [  # "executable = module:function"; each is installed in lib/NAME
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
    "sensitivity = worm_optimizer.commands.sensitivity:main",
]
# Dependencies that pip installs for a worker of a study, which needs no ROS; pyproject.toml pins the versions.
NEEDED = ["worm_model", "numpy", "scipy", "PyYAML", "matplotlib", "pymoo", "jinja2", "markdown2"]
CONSOLE = ["nicegui"]
STUDY = ["distributed", "xarray"]

setup(
    name=NAME,
    version="0.1.0",
    description="Robust gaits for the worm, and the bring-up of its node graph.",
    license="Apache-2.0",
    maintainer="The worm robot maintainers",
    maintainer_email="maintainers@worm.example",
    packages=find_packages(),
    package_data={NAME: ["config/*", "report/*.jinja", "study/*.jinja"]},
    install_requires=NEEDED,
    extras_require={
        "study": STUDY,
        "console": CONSOLE,
        "test": ["pytest"],
    },  # because of "test", colcon test uses pytest
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", sorted(glob("config/*") + glob(f"{NAME}/config/*.yaml"))),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
    ],
    entry_points={"console_scripts": EXECUTABLES},
)
