# SPDX-License-Identifier: Apache-2.0
"""The power sensor and the I2C bus that it is on."""
