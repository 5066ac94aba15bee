# SPDX-License-Identifier: Apache-2.0
"""Samples that the twin reads and records that it outputs, without compiled code.

Programs that only show or request something import these modules without loading the compiler.
"""
