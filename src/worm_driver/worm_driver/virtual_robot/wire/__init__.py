# SPDX-License-Identifier: Apache-2.0
"""The bytes of the virtual robot: servo line, I2C line, and their faults."""
