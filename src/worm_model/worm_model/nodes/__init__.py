# SPDX-License-Identifier: Apache-2.0
"""ROS nodes of the twin, the recorder, the player and the live view. Other packages of worm_model contain the logic."""
