# SPDX-License-Identifier: Apache-2.0
"""The twin, the recorder, the player and the view as ROS nodes: convert, one call, publish."""
