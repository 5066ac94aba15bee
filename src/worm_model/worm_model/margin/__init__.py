# SPDX-License-Identifier: Apache-2.0
"""Measured margin: what each cycle of a recorded run had to spare before a fin would have missed its groove."""
