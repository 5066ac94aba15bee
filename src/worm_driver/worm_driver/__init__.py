# SPDX-License-Identifier: Apache-2.0
"""Driver, tracker and virtual robot of the worm: servos, power sensor, camera."""
