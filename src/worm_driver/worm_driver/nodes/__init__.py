# SPDX-License-Identifier: Apache-2.0
"""The driver, the virtual robot and their ROS interfaces: convert, one call, publish."""
