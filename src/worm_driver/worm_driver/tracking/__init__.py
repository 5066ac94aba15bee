# SPDX-License-Identifier: Apache-2.0
"""From images of printed markers to positions of the modules in the pipe. Only ``vision`` knows OpenCV."""
