# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the tracker. Each message names the problem, the place and the remedy."""

from worm_driver.driver_errors import DriverError


class TrackingError(DriverError):
    """Base class of the tracker's exceptions."""


class SetupError(TrackingError):
    """Invalid setup file or calibration."""


class ImageError(TrackingError):
    """Unreadable image, video or camera."""


class PoseError(TrackingError):
    """Camera pose that cannot be determined from the visible reference markers."""
