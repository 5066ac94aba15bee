# SPDX-License-Identifier: Apache-2.0
"""Exact simulator, digital twin and identification of the worm."""
