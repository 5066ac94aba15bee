# SPDX-License-Identifier: Apache-2.0
"""Module positions from camera images of printed markers. Of its modules, only ``vision`` imports OpenCV."""
