# SPDX-License-Identifier: Apache-2.0
"""Console of the robot in a browser. `control`, `picture` and `view` need neither ROS nor NiceGUI."""
