# SPDX-License-Identifier: Apache-2.0
"""Start, supervision and shutdown of the node graph, and operations with it: demo, campaign, identification."""
