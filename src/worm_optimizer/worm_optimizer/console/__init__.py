# SPDX-License-Identifier: Apache-2.0
"""Console of the robot in a browser: pages, and below them a core without ROS and without the library of the pages."""
