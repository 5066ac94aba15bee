# SPDX-License-Identifier: Apache-2.0
"""ROS node of the optimizer, and the operator node that `operate`, demo, campaign and console use."""
