# SPDX-License-Identifier: Apache-2.0
"""Power sensor and its I2C bus."""
