# SPDX-License-Identifier: Apache-2.0
"""One virtual servo: registers, motor, measurement."""
