# SPDX-License-Identifier: Apache-2.0
"""Control of the robot at a fixed rate: supervision, timing and the resources of a configured driver. Free of ROS."""
