# SPDX-License-Identifier: Apache-2.0
"""Servo bus at the level of bytes, packets and registers, without any knowledge of a robot."""
