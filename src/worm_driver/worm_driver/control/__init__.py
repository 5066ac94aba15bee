# SPDX-License-Identifier: Apache-2.0
"""The robot in its loop: supervision, timing, and what a configured driver holds. Pure but for its threads."""
