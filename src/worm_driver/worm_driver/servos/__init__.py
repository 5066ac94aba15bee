# SPDX-License-Identifier: Apache-2.0
"""The servo bus, byte for byte: control tables, packets, the port. Knows no robot."""
