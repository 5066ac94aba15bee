# SPDX-License-Identifier: Apache-2.0
"""ROS nodes of the twin, the recorder, the player and the live view. They convert, make one call and publish."""
