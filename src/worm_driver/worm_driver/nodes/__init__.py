# SPDX-License-Identifier: Apache-2.0
"""ROS nodes of the driver, the tracker and the virtual robot, with their interfaces."""
