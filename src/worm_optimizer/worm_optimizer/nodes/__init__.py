# SPDX-License-Identifier: Apache-2.0
"""ROS node of the optimizer, and the operator node that the commands use to operate a robot."""
