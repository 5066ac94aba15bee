# SPDX-License-Identifier: Apache-2.0
"""Driver, recorder and virtual robot of the worm: servos, power sensor, bags."""
