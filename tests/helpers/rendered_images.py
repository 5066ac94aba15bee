# SPDX-License-Identifier: Apache-2.0
"""Camera images of a rig, rendered for the tests of the tracker.

The geometry shares no code with the tracker that processes the images. Each pixel is the mean over several rays, spread
over its area and over the exposure. Each ray is intersected with the plane of a print (a printed marker).
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Window = tuple[slice, slice]
Pair = tuple[float, float]
Point = tuple[float, float, float]

WHOLE = (slice(None), slice(None))
_PAPER, _INK = 1.0, 0.07  # reflectances of a print
# Reflectances of a module, of the pipe's wall and beyond the pipe.
_MODULE, _WALL, _BACKGROUND = 0.38, 0.55, 0.72
_MODULE_SIZE = (0.048, 0.062)  # visible part of a module along x and z, m
# Number of fixed-point iterations that remove the distortion. The error is well below a thousandth of a pixel.
_UNDISTORTIONS = 25
_EXPOSURE_PARTS = 3  # number of moments of an exposure
_RAYS = 4  # rays of a pixel along a row and along a column


def framed(rows: Sequence[str]) -> Array:
    """Return the reflectances of a print's cells with its black frame and white margin, row by row from the top.

    ``rows`` contain the marker's bits, "1" for white and "0" for black.
    """
    bits = np.array([[float(bit) for bit in row] for row in rows])
    return _INK + (_PAPER - _INK) * np.pad(np.pad(bits, 1), 1, constant_values=1.0)


# Bits of the printed markers (DICT_4X4_50) from the top left; 1 is white.
MARKERS = {
    0: ["1011", "0101", "0011", "0010"],
    1: ["0000", "1111", "1001", "1010"],
    10: ["1111", "1001", "1001", "0001"],
    11: ["0001", "0001", "1010", "0111"],
    12: ["0000", "1110", "1011", "0111"],
    13: ["0010", "1010", "0000", "1111"],
}


@dataclass(frozen=True)
class CameraSettings:
    """True values of the camera, of the markers and of the light; the setup that the tracker reads is tracker.yaml.

    SI units in the pipe's frame of REP 103: x forward, y left, z up.

    Attributes:
        focal, centre: pixels; the default is a common webcam with 65 degrees.
        distortion: k1, k2, p1, p2, k3 of Brown's model.
        position: place of the lens; with y < 0, +x is to the right in the image.
        yaw: angle of the viewing direction from +y, positive to the left.
        pitch_angle: angle of the viewing direction from the horizontal, positive upwards.
        roll: rotation of the camera about the viewing direction, positive clockwise.
        pixel_spread: blur by lens and sensor: side of the area over which a pixel averages, pixels.
        exposure: duration of an exposure.
        light: grey level of white in the middle.
        light_slope: relative change from the left to the right edge, and from the top to the bottom.
        noise_dark, noise_bright: standard deviation of the sensor's noise at grey levels 0 and 255, grey levels.
        ridge_transmission: transmission of the acrylic at a ridge of the pipe.
        glare: reflections of the lamps in the acrylic, grey levels.
        glare_heights: heights of these reflections, two bright streaks along the pipe.
        module_line: y and z of the modules' markers 0 (rear) and 1 (front).
        reference: centres of the markers next to the pipe, facing the camera.
    """

    width: int = 1280
    height: int = 720
    focal: float = 1010.0
    centre: Pair = (652.3, 351.8)
    distortion: tuple[float, ...] = (0.085, -0.19, 0.0011, -0.0008, 0.06)
    position: Point = (0.05, -0.61, 0.14)
    yaw: float = -0.24
    pitch_angle: float = -0.21
    roll: float = 0.02
    pixel_spread: float = 1.3
    exposure: float = 0.008
    light: float = 165.0
    light_slope: Pair = (-0.25, 0.3)
    noise_dark: float = 1.6
    noise_bright: float = 2.6
    ridge_transmission: float = 0.93
    glare: float = 45.0
    glare_heights: Pair = (0.014, -0.027)
    ridge_pitch: float = 0.0173
    pipe_radius: float = 0.045
    marker_size: float = 0.025
    module_line: Pair = (-0.02, 0.0)
    reference: Mapping[int, Point] = field(
        default_factory=lambda: {
            10: (0.0, -0.035, 0.075),
            11: (0.4, -0.035, 0.075),
            12: (0.0, -0.035, -0.075),
            13: (0.4, -0.035, -0.075),
        }
    )


def axes_of(settings: CameraSettings) -> Array:
    """Return the optical axes (right, down, forward) in the pipe's frame as rows."""
    yaw, pitch, roll = settings.yaw, settings.pitch_angle, settings.roll
    forward = np.array([-np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    level = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    right = np.cos(roll) * level + np.sin(roll) * np.cross(forward, level)
    return np.array([right, np.cross(forward, right), forward])


def pixels_of(settings: CameraSettings, points: Array) -> Array:
    """Return the pixels, shape (n, 2), of points in the pipe's frame, shape (n, 3), m."""
    s = settings
    seen = (points - np.array(s.position)) @ axes_of(s).T
    x, y = (seen[:, :2] / seen[:, 2:]).T
    k1, k2, p1, p2, k3 = s.distortion
    r2 = x * x + y * y
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent = np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )
    return bent * s.focal + np.array(s.centre)


class Pattern:
    """Print of rectangular cells, whose reflectances are given row by row from the top.

    In its plane, the centre is (0, 0), u points right and v up, m. ``cell`` is the size of a cell along u and v, m.
    """

    def __init__(self, cells: Array, cell: Pair) -> None:
        self._cells, self._cell = cells, np.array(cell)
        self.half = self._cell * cells.shape[::-1] / 2.0

    def over(self, behind: Array, u: Array, v: Array) -> Array:
        """Return the reflectance at points of the plane (m), which beyond the print is that of the scene behind it."""
        rows, columns = self._cells.shape
        column = np.floor((u + self.half[0]) / self._cell[0]).astype(int)
        row = np.floor((self.half[1] - v) / self._cell[1]).astype(int)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(inside, self._cells[row * inside, column * inside], behind)


class RenderedCamera:
    """Renderer of the camera's images for given module positions. ``seed`` is the seed of the sensor noise."""

    def __init__(self, settings: CameraSettings, seed: int = 0) -> None:
        self.settings = settings
        self._random = np.random.default_rng(seed)
        self._rays = self._pixel_rays()
        self._steps = np.gradient(self._rays, axis=1), np.gradient(self._rays, axis=0)
        self._light = self._lighting()
        self._gain, self._glare = self._acrylic()
        cell = settings.marker_size / 6.0
        self._prints = {n: Pattern(framed(rows), (cell, cell)) for n, rows in MARKERS.items()}
        self._body = Pattern(np.full((1, 1), _MODULE), _MODULE_SIZE)
        self._still = self._background()
        self._empty = self._exposed(self._still).astype(np.float32)
        share = np.clip(self._empty, 0.0, 255.0) / np.float32(255.0)
        dark, bright = np.float32(settings.noise_dark), np.float32(settings.noise_bright)
        self._noisiness = dark + (bright - dark) * share

    # --- static scene -----------------------------------------------------------------------------

    def _pixel_rays(self) -> Array:
        """Return the direction of each pixel's ray in the pipe's frame, shape (height, width, 3)."""
        s = self.settings
        column, row = np.meshgrid(np.arange(s.width, dtype=float), np.arange(s.height, dtype=float))
        bent_x, bent_y = (column - s.centre[0]) / s.focal, (row - s.centre[1]) / s.focal
        x, y = bent_x.copy(), bent_y.copy()
        k1, k2, p1, p2, k3 = s.distortion
        for _ in range(_UNDISTORTIONS):
            r2 = x * x + y * y
            radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
            x = (bent_x - 2.0 * p1 * x * y - p2 * (r2 + 2.0 * x * x)) / radial
            y = (bent_y - p1 * (r2 + 2.0 * y * y) - 2.0 * p2 * x * y) / radial
        return np.stack([x, y, np.ones_like(x)], axis=2) @ axes_of(self.settings)

    def _plane(self, y: float, window: Window, right: float, down: float) -> tuple[Array, Array]:
        """Return x and z (m) of the points of the plane at y (m) that the pixels of a window show.

        ``right`` and ``down`` (pixels) are the distance of the rays from the centres of the pixels.
        """
        camera = self.settings.position
        step = right * self._steps[0][window] + down * self._steps[1][window]
        rays = self._rays[window] + step
        along = (y - camera[1]) / rays[..., 1]
        return camera[0] + along * rays[..., 0], camera[2] + along * rays[..., 2]

    def scene(
        self, behind: Array, window: Window, y: float, pattern: Pattern, centres: Array
    ) -> Array:
        """Return the reflectances in a window with a print in the plane at y (m).

        ``centres`` are the places (x, z) of its centre during the exposure, shape (moments, 2), m.
        """
        spread = self.settings.pixel_spread * ((np.arange(_RAYS) + 0.5) / _RAYS - 0.5)
        total = np.zeros(behind.shape)
        for right, down in itertools.product(spread, spread):
            x, z = self._plane(y, window, right, down)
            for centre in centres:
                total += pattern.over(behind, x - centre[0], z - centre[1])
        return total / (_RAYS * _RAYS * len(centres))

    def _window(self, centre: tuple[float, float, float], half: Sequence[float] | Array) -> Window:
        """Return the pixels that can contain a rectangle with a centre (x, y, z) and half sizes along x and z, m."""
        s, (x, y, z) = self.settings, centre
        corners = [[x + a * half[0], y, z + b * half[1]] for a in (-1, 1) for b in (-1, 1)]
        pixels = pixels_of(s, np.array(corners))
        low = np.floor(pixels.min(axis=0)).astype(int) - 6
        high = np.ceil(pixels.max(axis=0)).astype(int) + 7
        columns, rows = (
            slice(*np.clip([low[axis], high[axis]], 0, size))
            for axis, size in ((0, s.width), (1, s.height))
        )
        return rows, columns

    def _lighting(self) -> Array:
        s = self.settings
        across, down = np.linspace(-0.5, 0.5, s.width), np.linspace(-0.5, 0.5, s.height)[:, None]
        return s.light * (1.0 + s.light_slope[0] * across) * (1.0 + s.light_slope[1] * down)

    def _acrylic(self) -> tuple[Array, Array]:
        """Return the transmission of the pipe's front wall and the grey levels of its reflections."""
        s = self.settings
        x, z = self._plane(-s.pipe_radius, WHOLE, 0.0, 0.0)
        within = np.abs(z) < s.pipe_radius
        ridge = 0.5 + 0.5 * np.cos(2.0 * np.pi * x / s.ridge_pitch)
        gain = np.where(within, 1.0 - (1.0 - s.ridge_transmission) * ridge**4, 1.0)
        streaks = sum(np.exp(-(((z - height) / 0.0012) ** 2)) for height in s.glare_heights)
        # The ridges split the lamps' reflections into chains of bright spots.
        glare = s.glare * np.asarray(streaks) * (0.35 + 0.65 * ridge**2)
        return gain, np.where(within, glare, 0.0)

    def _background(self) -> Array:
        s = self.settings
        _, height = self._plane(-s.pipe_radius, WHOLE, 0.0, 0.0)
        scene = np.where(np.abs(height) < s.pipe_radius, _WALL, _BACKGROUND)
        for number, (x, y, z) in s.reference.items():
            window = self._window((x, y, z), self._prints[number].half)
            centre = np.array([[x, z]])
            scene[window] = self.scene(scene[window], window, y, self._prints[number], centre)
        return scene

    # --- moving parts -----------------------------------------------------------------------------

    def image(self, rear: float, front: float) -> Image:
        """Return the image of modules at rest, shape (height, width), 8 bit grey; x1 and x2 in m, NaN if hidden."""
        return self._image(np.array([[rear, front]]))

    def moving_image(self, motion: Callable[[float], tuple[float, float]], time: float) -> Image:
        """Return the image of modules that move during the exposure around a time (s); see `image`."""
        parts = (np.arange(_EXPOSURE_PARTS) + 0.5) / _EXPOSURE_PARTS - 0.5
        return self._image(
            np.array([motion(time + part * self.settings.exposure) for part in parts])
        )

    def _image(self, path: Array) -> Image:
        """Return the image for x1 and x2 (m) at moments of the exposure, shape (moments, 2)."""
        levels, (y, z) = self._empty.copy(), self.settings.module_line
        for number, xs in enumerate(path.T):
            if not np.isfinite(xs).all():
                continue
            scene, middle = self._still.copy(), xs.mean()
            for each, centres in ((self._body, xs[:1]), (self._prints[number], xs)):
                window = self._window((middle, y, z), each.half + np.ptp(xs))
                places = np.column_stack([centres, np.full(len(centres), z)])
                scene[window] = self.scene(scene[window], window, y, each, places)
            window = self._window((middle, y, z), self._body.half + np.ptp(xs))
            levels[window] = self._exposed(scene[window], window)
        return self._digitise(levels)

    def _exposed(self, scene: Array, window: Window = WHOLE) -> Array:
        """Return the grey levels of a scene of reflectances, without noise."""
        return scene * self._light[window] * self._gain[window] + self._glare[window]

    def _digitise(self, levels: NDArray[np.float32]) -> Image:
        """Return the image with sensor noise, in whole grey levels."""
        levels += self._noisiness * self._random.standard_normal(levels.shape, np.float32)
        levels += 0.5
        return np.clip(levels, 0.0, 255.0, out=levels).astype(np.uint8)
