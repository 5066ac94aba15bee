# SPDX-License-Identifier: Apache-2.0
"""The optimizer as a ROS node, and the operator of demo and campaign."""
