# SPDX-License-Identifier: Apache-2.0
"""All that is asked of OpenCV: images in, corners of markers out, and the geometry of its camera models.

The only importer of cv2. Images are arrays of shape (height, width), grey, unless said otherwise; pixels are (column,
row) with (0, 0) in the middle of the first one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from worm_driver.tracking.camera_model import Array, CameraModel
from worm_driver.tracking.tracking_errors import ImageError

Image = NDArray[np.uint8]

# A camera's images come one by one, and a second thread would only wait for the first.
cv2.setNumThreads(1)

_UNIT = np.eye(3)
_EXACT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-9)
_PROFILE = np.linspace(-0.9, 0.9, 19)  # cells from an edge, inwards to outwards
_ALONG = np.linspace(0.1, 0.9, 25)  # of an edge, clear of the corners, which blur rounds
_FEWEST = 8  # of those points that must lie on a line
_LEAST_RISE = 12.0  # grey levels from the frame to the white
_REFINEMENTS = 2
_REJECTIONS = 3
_USUAL = 0.1  # pixels, that a point is off its line by noise alone
_BORDER = 2  # cells of the frame that a marker has beside its bits


@dataclass(frozen=True)
class Detection:
    """A marker in an image.

    Attributes:
        number: its id.
        corners: pixels, shape (4, 2): top left, top right, bottom right, bottom left of the print.
        edge_width: 10 to 90 % of its edges' rise, in cells of the marker; a sharp image is well below a half.
    """

    number: int
    corners: Array
    edge_width: float


class MarkerDetector:
    """Finds the markers of one dictionary (OpenCV's name)."""

    def __init__(self, dictionary: str):
        markers = _dictionary(dictionary)
        self._cells = markers.markerSize + _BORDER
        settings = cv2.aruco.DetectorParameters()
        # One threshold, of a window that is wider than a cell of a marker of 40 pixels.
        settings.adaptiveThreshWinSizeMin = settings.adaptiveThreshWinSizeMax = 23
        self._detector = cv2.aruco.ArucoDetector(markers, settings)

    def detect(self, image: Image) -> list[Detection]:
        """The markers in an image; one that is there twice stands there twice."""
        quadrilaterals, numbers, _ = self._detector.detectMarkers(image)
        if numbers is None:
            return []
        first = np.concatenate(quadrilaterals).astype(float)
        corners, widths = first, np.empty(len(first))
        for _ in range(_REFINEMENTS):
            corners, widths = _refined(image, corners, self._cells)
        cell = np.hypot(*(first[:, 1] - first[:, 0]).T) / self._cells
        # Where the edges lead away from what OpenCV found, they are not the marker's.
        lost = ~(np.abs(corners - first).max(axis=(1, 2)) < cell)
        corners[lost], widths[lost] = first[lost], np.inf
        return [
            Detection(int(number), quad, float(width))
            for number, quad, width in zip(numbers.ravel(), corners, widths, strict=True)
        ]


def _refined(image: Image, corners: Array, cells: int) -> tuple[Array, Array]:
    """Corners where lines through the four edges meet, shape (markers, 4, 2), and how wide the edges are (cells).

    An edge is where the grey level is half way between the frame and the white beside it, which blur does not move; a
    line through many such points is several times as exact as OpenCV's own corners, which blur draws inwards.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.hypot(sides[..., 0], sides[..., 1])
    outwards = np.stack([sides[..., 1], -sides[..., 0]], axis=-1) / lengths[..., None]
    reach = lengths / cells  # a cell, pixels
    starts = corners + _ALONG[:, None, None, None] * sides  # (along, marker, side, 2)
    across = _PROFILE[:, None, None, None, None] * (reach[..., None] * outwards)
    points = (starts[None] + across).reshape(len(_PROFILE), -1, 2).astype(np.float32)
    columns, rows = points[..., 0], points[..., 1]
    values = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shares = _shares(values.reshape(len(_PROFILE), len(_ALONG), *lengths.shape).astype(float))
    offset, slope = _lines(_crossings(shares) * reach)
    begin = corners + offset[..., None] * outwards
    end = corners + sides + (offset + slope)[..., None] * outwards
    return _meetings(begin, end), _rises(shares)


def _shares(profiles: Array) -> Array:
    """Profiles from 0 (the frame) to 1 (the white beside it); NaN where there is no rise."""
    low, high = profiles[:3].mean(axis=0), profiles[-3:].mean(axis=0)
    rise = np.where(high - low > _LEAST_RISE, high - low, np.nan)
    shares: Array = (profiles - low) / rise
    return shares


def _crossings(shares: Array) -> Array:
    """Where profiles first rise above a half, cells, shape (along, …); NaN where they do not."""
    above = shares > 0.5
    index = np.clip(above.argmax(axis=0), 1, len(_PROFILE) - 1)
    before, after = (np.take_along_axis(shares, index[None] - back, axis=0)[0] for back in (1, 0))
    step = _PROFILE[1] - _PROFILE[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        places: Array = _PROFILE[index - 1] + step * (0.5 - before) / (after - before)
    return np.where(above.any(axis=0) & ~above[0], places, np.nan)


def _lines(places: Array) -> tuple[Array, Array]:
    """Offset and slope of a line through each edge's points (along, …), without those that lie off it.

    NaN where too few are left.
    """
    good = np.isfinite(places)
    d = np.where(good, places, 0.0)
    t = _ALONG.reshape(-1, *[1] * (d.ndim - 1))
    for _ in range(_REJECTIONS):
        count = np.maximum(good.sum(axis=0), 1)
        middle_t, middle_d = (good * t).sum(axis=0) / count, (good * d).sum(axis=0) / count
        off_t = good * (t - middle_t)
        slope = (off_t * d).sum(axis=0) / np.maximum((off_t * off_t).sum(axis=0), 1e-9)
        offset = middle_d - slope * middle_t
        wrong = np.where(good, np.abs(d - offset - slope * t), np.inf)
        usual = np.take_along_axis(np.sort(wrong, axis=0), (count // 2)[None], axis=0)[0]
        good &= wrong <= 3.0 * np.maximum(usual, _USUAL)
    enough = good.sum(axis=0) >= _FEWEST
    return np.where(enough, offset, np.nan), np.where(enough, slope, np.nan)


def _meetings(begin: Array, end: Array) -> Array:
    """The corners of four lines in turn, shape (markers, 4, 2): each line meets the one before it."""
    start, along = begin, end - begin
    other, across = np.roll(begin, 1, axis=1), np.roll(along, 1, axis=1)
    # start + s * along = other + r * across
    apart = other - start
    turn = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    share = (apart[..., 0] * across[..., 1] - apart[..., 1] * across[..., 0]) / turn
    corners: Array = start + share[..., None] * along
    return corners


def _rises(shares: Array) -> Array:
    """Cells from 10 to 90 % of each marker's edges, the wider of its two directions, from the area of the rise."""
    there = np.isfinite(shares)
    count = np.maximum(there.sum(axis=1), 1)
    mean = np.where(there, shares, 0.0).sum(axis=1) / count  # (profile, marker, side)
    share = np.clip(
        (mean[..., :2] + mean[..., 2:]) / 2.0, 0.0, 1.0
    )  # opposite sides are blurred alike
    # The area under s(1 - s) of a linear ramp of width w is w / 6, and 10 to 90 % are 0.8 w.
    width = 0.8 * 6.0 * (share * (1.0 - share)).sum(axis=0) * (_PROFILE[1] - _PROFILE[0])
    rises: Array = width.max(axis=-1)
    return rises


# --- geometry -------------------------------------------------------------------------------------


def project(camera: CameraModel, points: Array, rotation: Array, shift: Array) -> Array:
    """Pixels, shape (n, 2), of points (n, 3) in m that the camera sees at rotation @ point + shift."""
    turn = cv2.Rodrigues(rotation)[0]
    distortion = np.array(camera.distortion)
    places = points.reshape(-1, 1, 3)
    if camera.model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(places, turn, shift, camera.matrix, distortion)
    else:
        pixels, _ = cv2.projectPoints(places, turn, shift, camera.matrix, distortion)
    return np.asarray(pixels, float).reshape(-1, 2)


def directions(camera: CameraModel, pixels: Array) -> Array:
    """(x/z, y/z), shape (n, 2), of what is seen at pixels; NaN where the lens model has no inverse."""
    distortion = np.array(camera.distortion)
    image_points = np.ascontiguousarray(pixels, float).reshape(-1, 1, 2)
    if camera.model == "equidistant":
        undistorted = cv2.fisheye.undistortPoints(
            image_points, camera.matrix, distortion, criteria=_EXACT
        )
    else:
        undistorted = cv2.undistortPointsIter(
            image_points, camera.matrix, distortion, None, None, _EXACT
        )
    rays = np.asarray(undistorted, float).reshape(-1, 2)
    ahead = np.column_stack([rays, np.ones(len(rays))])
    again = project(camera, ahead, np.eye(3), np.zeros(3))
    rays[~(np.abs(again - pixels.reshape(-1, 2)).max(axis=1) < 1e-3)] = np.nan
    return rays


def poses(points: Array, rays: Array) -> list[tuple[Array, Array]]:
    """Rotation and shift of each camera that may have seen points (n, 3) at directions (n, 2), refined.

    Points in a plane may have been seen from two places: both are returned (IPPE, Collins and Bartoli 2014).
    """
    centre = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - centre)
    flat = spread[2] < 1e-6 * spread[0]
    if np.linalg.det(axes) < 0.0:
        axes[2] = -axes[2]
    own = (points - centre) @ axes.T
    # IPPE fails where the vanishing line is exactly parallel to an axis; SQPNP knows one of the two poses only.
    methods = [cv2.SOLVEPNP_SQPNP]
    if flat:
        own[:, 2] = 0.0
        methods.append(cv2.SOLVEPNP_IPPE)
    candidates = []
    for method in methods:
        _, turns, shifts, _ = cv2.solvePnPGeneric(own, rays, _UNIT, None, flags=method)
        for turn, shift in zip(turns, shifts, strict=True):
            if not np.isfinite([turn, shift]).all():
                continue
            better = cv2.solvePnPRefineLM(own, rays, _UNIT, None, turn, shift)
            rotation = cv2.Rodrigues(better[0])[0] @ axes
            candidates.append((rotation, better[1].ravel() - rotation @ centre))
    return candidates


# --- dictionaries ---------------------------------------------------------------------------------


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_cells(dictionary: str, number: int) -> NDArray[np.bool_]:
    """A marker's cells with its frame, shape (n, n), row by row from the top; true is white."""
    markers = _dictionary(dictionary)
    side = markers.markerSize + _BORDER
    cells: NDArray[np.bool_] = cv2.aruco.generateImageMarker(markers, number, side) > 0
    return cells


# --- calibration ----------------------------------------------------------------------------------


class Board:
    """A ChArUco board: a chessboard with a marker in each white square, so that a part of it is enough.

    Args:
        columns, rows: of squares.
        square: side of a square, m; the markers' is 0.72 of it.
        dictionary: of the markers.
    """

    def __init__(self, columns: int, rows: int, square: float, dictionary: str):
        self._board = cv2.aruco.CharucoBoard(
            (columns, rows), square, 0.72 * square, _dictionary(dictionary)
        )
        self._detector = cv2.aruco.CharucoDetector(self._board)

    def draw(self, pixels_per_square: int) -> Image:
        """The board as an image."""
        columns, rows = self._board.getChessboardSize()
        size = columns * pixels_per_square, rows * pixels_per_square
        return np.asarray(self._board.generateImage(size), np.uint8)

    def find(self, image: Image) -> tuple[Array, Array]:
        """The inner corners seen in an image: on the board (n, 3) in m, and in the image (n, 2) in pixels."""
        corners, numbers, _, _ = self._detector.detectBoard(image)
        if numbers is None or len(numbers) == 0:
            return np.empty((0, 3)), np.empty((0, 2))
        places = self._board.getChessboardCorners()[numbers.ravel()]
        return np.asarray(places, float), np.asarray(corners, float).reshape(-1, 2)


@dataclass(frozen=True)
class Calibration:
    """A camera and how well it fits: rms and that of each view (pixels), deviation of the focal length (pixels)."""

    camera: CameraModel
    error: float
    view_errors: Array
    focal_deviation: float


def calibrate(
    views: Sequence[tuple[Array, Array]], size: tuple[int, int], model: str
) -> Calibration:
    """The camera that has seen a board's corners.

    Args:
        views: as `Board.find` returns them.
        size: of the images (width, height), pixels.
        model: plumb_bob or rational_polynomial.
    """
    flags = cv2.CALIB_RATIONAL_MODEL if model == "rational_polynomial" else 0
    places = [place.astype(np.float32) for place, _ in views]
    pixels = [corners.astype(np.float32).reshape(-1, 1, 2) for _, corners in views]
    error, matrix, distortion, _, _, deviations, _, errors = cv2.calibrateCameraExtended(
        places, pixels, size, None, None, flags=flags
    )
    count = 8 if flags else 5
    camera = CameraModel(
        *size,
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        model,
        tuple(float(value) for value in distortion.ravel()[:count]),
    )
    return Calibration(camera, float(error), np.asarray(errors).ravel(), float(deviations[0, 0]))


# --- images ---------------------------------------------------------------------------------------


def read_image(path: Path) -> Image:
    """An image file, grey. Raises ImageError."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image")
    return np.asarray(image, np.uint8)


def decode_image(data: bytes) -> Image:
    """A JPEG, PNG or other image file's bytes, grey. Raises ImageError."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise ImageError(f"{len(data)} bytes are no image")
    return np.asarray(image, np.uint8)


def write_image(path: Path, image: Image) -> None:
    """Writes an image file, grey or (height, width, 3) blue, green, red; its name's ending decides the form."""
    if not cv2.imwrite(str(path), image):
        raise ImageError(f"{path} cannot be written")


_TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
    "yuv422": cv2.COLOR_YUV2GRAY_UYVY,
    "uyvy": cv2.COLOR_YUV2GRAY_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2GRAY_YUY2,
    "yuyv": cv2.COLOR_YUV2GRAY_YUY2,
}
_CHANNELS = {"mono8": 1, "bgr8": 3, "rgb8": 3, "bgra8": 4, "rgba8": 4} | dict.fromkeys(
    ("yuv422", "uyvy", "yuv422_yuy2", "yuyv"), 2
)


def grey(data: NDArray[np.uint8], height: int, width: int, step: int, encoding: str) -> Image:
    """The pixels of a sensor_msgs/Image, whose rows are step bytes apart, as a grey image.

    Raises ImageError: the encoding is none of those of 8 bits that cameras send, or the data are too few.
    """
    if encoding not in _CHANNELS:
        raise ImageError(
            f"images in {encoding!r} are not supported: set the camera to one of {', '.join(_CHANNELS)}"
        )
    used = width * _CHANNELS[encoding]
    if step < used or len(data) < height * step:
        raise ImageError(
            f"an image of {width} x {height} in {encoding} with {len(data)} bytes is cut off"
        )
    rows = data[: height * step].reshape(height, step)[:, :used]
    if encoding == "mono8":
        return np.ascontiguousarray(rows)
    pixels = np.ascontiguousarray(rows).reshape(height, width, _CHANNELS[encoding])
    return np.asarray(cv2.cvtColor(pixels, _TO_GREY[encoding]), np.uint8)


class Film:
    """A film file or a V4L2 camera, image by image. Raises ImageError where it cannot be opened."""

    def __init__(self, source: str):
        self._source = source
        device = source.startswith("/dev/")
        backend = cv2.CAP_V4L2 if device else cv2.CAP_FFMPEG
        self._capture = cv2.VideoCapture(source, backend)
        if not self._capture.isOpened():
            hint = "is it plugged in, and in use by nothing else?" if device else "is it a film?"
            raise ImageError(f"{source} cannot be opened: {hint}")

    @property
    def rate(self) -> float:
        """Images per second as the film tells, 0 where it does not."""
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def ask_for(self, width: int, height: int, rate: float) -> None:
        """Asks a camera for a size and a rate (Hz, 0: its own); it may give another."""
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if rate:
            self._capture.set(cv2.CAP_PROP_FPS, rate)

    def read(self) -> tuple[Image, float] | None:
        """The next image, grey, and its time (s) in the film; None at the end."""
        there, image = self._capture.read()
        if not there:
            return None
        time = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) * 1e-3
        plain = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return np.asarray(plain, np.uint8), time

    def close(self) -> None:
        """Lets go of it."""
        self._capture.release()


# --- drawing --------------------------------------------------------------------------------------

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Label:
    """An outline with a text at its first point; colour is (blue, green, red)."""

    outline: Array
    text: str
    colour: Colour


def draw(image: Image, labels: Sequence[Label], title: Sequence[str]) -> Image:
    """An image in colour with outlines and texts, and lines of text in its corner."""
    drawn = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for label in labels:
        points = np.round(label.outline * 16).astype(np.int32)
        cv2.polylines(drawn, [points], True, label.colour, 2, cv2.LINE_AA, 4)
        left, top = label.outline.min(axis=0)
        _write(drawn, label.text, (int(left), int(top) - 8), label.colour)
    for row, line in enumerate(title):
        _write(drawn, line, (12, 28 + 26 * row), (255, 255, 255))
    return np.asarray(drawn, np.uint8)


def _write(image: Image, text: str, place: tuple[int, int], colour: Colour) -> None:
    font = cv2.FONT_HERSHEY_SIMPLEX
    for shade, thickness in (((0, 0, 0), 4), (colour, 1)):
        cv2.putText(image, text, place, font, 0.6, shade, thickness, cv2.LINE_AA)
