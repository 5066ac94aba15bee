# SPDX-License-Identifier: Apache-2.0
"""The validation campaign of Section V: three gaits of a robust front on a robot, measured against predicted."""
