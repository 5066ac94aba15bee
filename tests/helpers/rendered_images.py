# SPDX-License-Identifier: Apache-2.0
"""Camera images of a rig, rendered for the tests of the tracker.

The geometry shares no code with the tracker that processes the images. Each pixel's ray is intersected with the plane
of a print (a printed marker). The reflectance of the print is averaged over the pixel and over the exposure. It is
constant in each cell of the print, so both averages are differences of its integral. Edges are therefore exact to a
fraction of a pixel without sampling.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Window = tuple[slice, slice]
Pair = tuple[float, float]
Point = tuple[float, float, float]

_PAPER, _INK = 1.0, 0.07  # reflectances of a print
# Reflectances of a module, of the pipe's wall and beyond the pipe.
_MODULE, _WALL, _BACKGROUND = 0.38, 0.55, 0.72
_MODULE_SIZE = (0.048, 0.062)  # visible part of a module along x and z, m
# Number of fixed-point iterations that remove the distortion. The error is well below a thousandth of a pixel.
_UNDISTORTIONS = 25
_EXPOSURE_PARTS = 3  # number of equal parts of an exposure


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


class Pattern:
    """Print of rectangular cells. In its plane, the centre is (0, 0), u points right and v up, m."""

    def __init__(self, cells: Array, cell: tuple[float, float]) -> None:
        """Create a print.

        Args:
            cells: reflectances, row by row from the top.
            cell: size of a cell along u and v, m.
        """
        rows, columns = cells.shape
        self.half = (columns * cell[0] / 2.0, rows * cell[1] / 2.0)
        self._cell = cell
        # Integral of the reflectance over the area to the left of and below each corner, in units of a cell's area.
        self._sums = np.pad(np.cumsum(np.cumsum(cells[::-1], axis=0), axis=1), ((1, 0), (1, 0)))

    def average(self, u: Array, v: Array, du: Array, dv: Array) -> tuple[Array, Array]:
        """Return the mean reflectance of the print in rectangles, and the share of each rectangle that it covers.

        Args:
            u, v: centres of the rectangles, m.
            du, dv: sizes of the rectangles, m.
        """
        left, right = (self._along(u + sign * du / 2.0, 0) for sign in (-1, 1))
        low, high = (self._along(v + sign * dv / 2.0, 1) for sign in (-1, 1))
        inside = (right - left) * (high - low)
        whole = (
            self._at(right, high)
            - self._at(left, high)
            - self._at(right, low)
            + self._at(left, low)
        )
        share = inside * self._cell[0] * self._cell[1] / (du * dv)
        return np.divide(whole, inside, out=np.zeros_like(whole), where=inside > 0.0), share

    def _along(self, place: Array, axis: int) -> Array:
        count = self._sums.shape[1 - axis] - 1
        return np.clip((place + self.half[axis]) / self._cell[axis], 0.0, count)

    def _at(self, column: Array, row: Array) -> Array:
        """Return the integral of the reflectance to the left of and below positions (cells)."""
        c = np.minimum(column.astype(int), self._sums.shape[1] - 2)
        r = np.minimum(row.astype(int), self._sums.shape[0] - 2)
        fc, fr = column - c, row - r
        s = self._sums
        low = s[r, c] * (1.0 - fc) + s[r, c + 1] * fc
        high = s[r + 1, c] * (1.0 - fc) + s[r + 1, c + 1] * fc
        return low * (1.0 - fr) + high * fr


class Footprints(NamedTuple):
    """Footprints of pixels on a plane: centre (x, z) and size (m), each of shape (rows, columns)."""

    x: Array
    z: Array
    width: Array
    height: Array


def _put(
    scene: Array,
    footprints: Footprints,
    pattern: Pattern,
    centre: tuple[float, float],
    sweep: float,
) -> None:
    """Draw a pattern with its centre at (x, z), m, into a scene of reflectances.

    ``sweep`` is the pattern's motion along x during the exposure, m.
    """
    u, v = footprints.x - centre[0], footprints.z - centre[1]
    near = (np.abs(u) < pattern.half[0] + footprints.width + sweep) & (
        np.abs(v) < pattern.half[1] + footprints.height
    )
    rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    if not rows.size:
        return
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    sizes = footprints.width[part] + sweep, footprints.height[part]
    reflectance, share = pattern.average(u[part], v[part], *sizes)
    scene[part] = scene[part] * (1.0 - share) + reflectance * share


class RenderedCamera:
    """Renderer of the camera's images for given module positions. ``seed`` is the seed of the sensor noise."""

    def __init__(self, settings: CameraSettings, seed: int = 0) -> None:
        self.settings = settings
        self._random = np.random.default_rng(seed)
        self._rays = self._pixel_rays()
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

    def _plane(self, y: float, window: Window) -> tuple[Array, Array]:
        """Return x and z (m) of the point of the plane at y (m) that each pixel of a window shows."""
        rays, camera = self._rays[window], self.settings.position
        along = (y - camera[1]) / rays[..., 1]
        return camera[0] + along * rays[..., 0], camera[2] + along * rays[..., 2]

    def _window(self, centre: tuple[float, float, float], half: tuple[float, float]) -> Window:
        """Return the pixels that can contain a rectangle with a centre (x, y, z) and half sizes along x and z, m."""
        s, axes, (x, y, z) = self.settings, axes_of(self.settings), centre
        corners = np.array(
            [[x + a * half[0], y, z + b * half[1]] for a in (-1, 1) for b in (-1, 1)]
        )
        projected = (corners - np.array(s.position)) @ axes.T
        flat = projected[:, :2] / np.maximum(projected[:, 2:], 1e-3)
        r2 = (flat**2).sum(axis=1, keepdims=True)
        k1, k2, *_, k3 = s.distortion
        pixels = flat * (1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3) * s.focal + np.array(s.centre)
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
        x, z = self._plane(-s.pipe_radius, (slice(None), slice(None)))
        within = np.abs(z) < s.pipe_radius
        ridge = 0.5 + 0.5 * np.cos(2.0 * np.pi * x / s.ridge_pitch)
        gain = np.where(within, 1.0 - (1.0 - s.ridge_transmission) * ridge**4, 1.0)
        streaks = sum(np.exp(-(((z - height) / 0.0012) ** 2)) for height in s.glare_heights)
        # The ridges split the lamps' reflections into chains of bright spots.
        glare = s.glare * np.asarray(streaks) * (0.35 + 0.65 * ridge**2)
        return gain, np.where(within, glare, 0.0)

    def _background(self) -> Array:
        s = self.settings
        everything = (slice(None), slice(None))
        _, height = self._plane(-s.pipe_radius, everything)
        scene = np.where(np.abs(height) < s.pipe_radius, _WALL, _BACKGROUND)
        for number, (x, y, z) in s.reference.items():
            window = self._window((x, y, z), self._prints[number].half)
            part = scene[window]
            if min(part.shape) < 2:
                continue  # out of the image
            _put(part, self.footprints(y, window), self._prints[number], (x, z), 0.0)
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
        """Return the image for x1 and x2 (m) at the centres of equal parts of the exposure, shape (parts, 2)."""
        levels = self._empty.copy()
        for marker, centres in enumerate(path.T):
            if np.isfinite(centres).all():
                self._show(levels, marker, centres)
        return self._digitise(levels)

    def _show(self, levels: NDArray[np.float32], number: int, centres: Array) -> None:
        """Draw a module and its marker, averaged over the positions (m) of the marker's centre during the exposure."""
        y, z = self.settings.module_line
        middle, sweep = float(centres.mean()), float(np.ptp(centres))
        part = sweep / max(len(centres) - 1, 1)
        half = (_MODULE_SIZE[0] / 2.0 + sweep, _MODULE_SIZE[1] / 2.0)
        window = self._window((middle, y, z), half)
        if min(levels[window].shape) < 2:
            return  # out of the image
        footprints = self.footprints(y, window)
        behind = self._still[window].copy()
        _put(behind, footprints, self._body, (middle, z), sweep + part)
        sums = np.zeros(footprints.x.shape)
        for centre in centres:
            scene = behind.copy()
            _put(scene, footprints, self._prints[number], (float(centre), z), part)
            sums += scene
        levels[window] = self._exposed(sums / len(centres), window)

    def footprints(self, y: float, window: Window) -> Footprints:
        """Return the footprints of a window's pixels on a plane at y (m)."""
        x, z = self._plane(y, window)
        spread = self.settings.pixel_spread
        widths = spread * np.abs(np.gradient(x, axis=1)), spread * np.abs(np.gradient(z, axis=0))
        return Footprints(x, z, *widths)

    def _exposed(self, scene: Array, window: Window = (slice(None), slice(None))) -> Array:
        """Return the grey levels of a scene of reflectances, without noise."""
        return scene * self._light[window] * self._gain[window] + self._glare[window]

    def _digitise(self, levels: NDArray[np.float32]) -> Image:
        """Return the image with sensor noise, in whole grey levels."""
        levels += self._noisiness * self._random.standard_normal(levels.shape, np.float32)
        levels += 0.5
        return np.clip(levels, 0.0, 255.0, out=levels).astype(np.uint8)
