# SPDX-License-Identifier: Apache-2.0
"""Byte-level interfaces of the virtual robot: servo bus, I2C bus, and fault injection."""
