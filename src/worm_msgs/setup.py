# SPDX-License-Identifier: Apache-2.0
"""Package definition for pip, for computers without ROS: tables and helpers in plain Python, but no messages.

colcon builds this package with CMake, by package.xml. The other packages have one setup.py for colcon and pip. colcon
runs it, and `ros2 run` finds each executable as a script in lib/NAME (setup.cfg). pip builds wheels through
`setuptools.build_meta`. It would put the scripts into bin, where names such as `record` hide other programs. So a wheel
lists its executables in the entry point group worm.commands, and the only script, `worm`, runs them. pip builds in the
source tree; a temporary folder receives what it would leave there.

The required versions are the lowest that should do; the workspace pins those that are tested (pyproject.toml).
"""

from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from setuptools import setup

package = ElementTree.parse("package.xml")
with TemporaryDirectory() as scratch:
    setup(
        name="worm_msgs",
        version=package.findtext("version"),
        description="Tables that the packages of the worm robot share, and the command worm.",
        license=package.findtext("license"),
        packages=["worm_msgs"],
        package_data={"worm_msgs": ["py.typed"]},
        python_requires=">=3.11",
        install_requires=["numpy>=1.26", "pydantic>=2", "PyYAML>=6"],
        entry_points={"console_scripts": ["worm = worm_msgs.worm_command:main"]},
        options={"build": {"build_base": scratch}, "egg_info": {"egg_base": scratch}},
    )
