# SPDX-License-Identifier: Apache-2.0
"""What can go wrong with a camera, its setup and its images; every message says what, where, and what to do."""

from worm_driver.errors import DriverError


class TrackingError(DriverError):
    """Anything that makes tracking impossible."""


class SetupError(TrackingError):
    """A setup file, or a camera's calibration, that cannot be used."""


class ImageError(TrackingError):
    """An image, a film or a camera that cannot be read."""


class PoseError(TrackingError):
    """The place of the camera cannot be told from the reference markers that are seen."""
