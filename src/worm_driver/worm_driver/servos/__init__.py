# SPDX-License-Identifier: Apache-2.0
"""Servo bus: packets, registers, setup and states of the servos; conversion of ticks into lengths and angles."""
