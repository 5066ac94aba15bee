# SPDX-License-Identifier: Apache-2.0
"""Bringing the node graph up: which nodes, started and stopped how, and the demo that uses them."""
