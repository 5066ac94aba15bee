# SPDX-License-Identifier: Apache-2.0
"""OpenCV interface: marker detection, camera geometry, calibration, image files and drawing.

No other module imports cv2. Images are grey arrays of shape (height, width) unless stated otherwise. Coordinates in
pixels are (column, row), with (0, 0) at the centre of the first pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from worm_driver.driver_errors import ImageError
from worm_driver.tracking.camera_model import Array, CameraModel

Image = NDArray[np.uint8]

# Images are processed one by one, and a second thread would save little time.
cv2.setNumThreads(1)

_UNIT = np.eye(3)
# Termination of the iterative removal of distortion.
_EXACT = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-9)
#: Positions across an edge, cells; negative: inside the black square.
_PROFILE = np.linspace(-0.9, 0.9, 19)
#: Positions along an edge, as shares of its length. They exclude the corners, because blur rounds the corners.
_ALONG = np.linspace(0.1, 0.9, 25)
_FEWEST = 8  # smallest number of points of an edge that determine its line
#: Smallest rise of the grey level from the black frame to the white around it that counts as an edge.
_LEAST_RISE = 12.0
_REFINEMENTS = 2  # number of refinements of the corners, each from the corners of the previous one
_REJECTIONS = 3  # number of fits of a line, each followed by a rejection of outliers
_USUAL = 0.1  # distance of a point from its line that noise alone can cause, pixels
_BORDER = 2  # number of cells of the black frame in each row of a marker, in addition to the bits


@dataclass(frozen=True)
class Detection:
    """Marker detected in an image.

    Attributes:
        number: marker id.
        corners: pixels, shape (4, 2): top left, top right, bottom right, bottom left of the print.
        edge_width: width of the edges from 10 to 90 % of the rise from black to white, cells of the marker; well below
            0.5 in a sharp image, infinite without clear edges.
    """

    number: int
    corners: Array
    edge_width: float


class MarkerDetector:
    """Detector of the markers of one dictionary (OpenCV name)."""

    def __init__(self, dictionary: str):
        markers = _dictionary(dictionary)
        self._cells = markers.markerSize + _BORDER
        settings = cv2.aruco.DetectorParameters()
        # One threshold window (pixels), wider than a cell of a marker whose side is 40 pixels.
        settings.adaptiveThreshWinSizeMin = settings.adaptiveThreshWinSizeMax = 23
        self._detector = cv2.aruco.ArucoDetector(markers, settings)

    def detect(self, image: Image) -> list[Detection]:
        """Return the markers in an image. A marker that is visible twice appears twice."""
        quadrilaterals, numbers, _ = self._detector.detectMarkers(image)
        if numbers is None:
            return []
        first = np.concatenate(quadrilaterals).astype(float)
        corners, widths = first, np.empty(len(first))
        for _ in range(_REFINEMENTS):
            corners, widths = _refined(image, corners, self._cells)
        cell = np.hypot(*(first[:, 1] - first[:, 0]).T) / self._cells
        # Refined corners far from OpenCV's corners belong to other edges.
        lost = ~(np.abs(corners - first).max(axis=(1, 2)) < cell)
        corners[lost], widths[lost] = first[lost], np.inf
        return [
            Detection(int(number), quad, float(width))
            for number, quad, width in zip(numbers.ravel(), corners, widths, strict=True)
        ]


def _refined(image: Image, corners: Array, cells: int) -> tuple[Array, Array]:
    """Return refined corners, shape (markers, 4, 2), and the width of each marker's edges, shape (markers,), cells.

    A corner is the intersection of the lines through two adjacent edges. A point of an edge is where the grey level is
    half way between the frame and the white around it. Blur does not move such points, but moves OpenCV's corners
    inwards. A line through many such points is several times more accurate than OpenCV's corners.
    """
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.hypot(sides[..., 0], sides[..., 1])
    outwards = np.stack([sides[..., 1], -sides[..., 0]], axis=-1) / lengths[..., None]
    reach = lengths / cells  # side of a cell, pixels
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
    """Return grey levels scaled from 0 (the frame) to 1 (the white around it); NaN where there is no edge."""
    low, high = profiles[:3].mean(axis=0), profiles[-3:].mean(axis=0)
    rise = np.where(high - low > _LEAST_RISE, high - low, np.nan)
    shares: Array = (profiles - low) / rise
    return shares


def _crossings(shares: Array) -> Array:
    """Return the position where each profile across an edge first exceeds 0.5, shape (along, …).

    Positions are in cells from the line between the corners. A position is NaN if the profile never exceeds 0.5 or
    begins above 0.5.
    """
    above = shares > 0.5
    index = np.clip(above.argmax(axis=0), 1, len(_PROFILE) - 1)
    before, after = (np.take_along_axis(shares, index[None] - back, axis=0)[0] for back in (1, 0))
    step = _PROFILE[1] - _PROFILE[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        places: Array = _PROFILE[index - 1] + step * (0.5 - before) / (after - before)
    return np.where(above.any(axis=0) & ~above[0], places, np.nan)


def _lines(places: Array) -> tuple[Array, Array]:
    """Return the offset (pixels, at the first corner) and slope (pixels per edge length) of a line through each edge.

    ``places`` are the distances of the edge's points from the line between the corners, pixels, shape (along, …).
    Outliers are rejected. The result is NaN where too few points remain.
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
    """Return the intersection of each side's line with the line of the previous side, shape (markers, 4, 2)."""
    start, along = begin, end - begin
    other, across = np.roll(begin, 1, axis=1), np.roll(along, 1, axis=1)
    # start + s * along = other + r * across
    apart = other - start
    turn = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    share = (apart[..., 0] * across[..., 1] - apart[..., 1] * across[..., 0]) / turn
    corners: Array = start + share[..., None] * along
    return corners


def _rises(shares: Array) -> Array:
    """Return the width of each marker's edges from 10 to 90 % of the rise, cells, shape (markers,).

    Opposite edges are averaged, and the result is the width of the wider pair.
    """
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
    """Return the pixels, shape (n, 2), to which a camera projects points (n, 3) in m.

    A point is at rotation @ point + shift (m) in the camera's optical frame.
    """
    turn = cv2.Rodrigues(rotation)[0]
    distortion = np.array(camera.distortion)
    places = points.reshape(-1, 1, 3)
    pixels, _ = cv2.projectPoints(places, turn, shift, camera.matrix, distortion)
    return np.asarray(pixels, float).reshape(-1, 2)


def directions(camera: CameraModel, pixels: Array) -> Array:
    """Return the ray directions (x/z, y/z), shape (n, 2), of pixels; NaN where the lens model has no inverse."""
    distortion = np.array(camera.distortion)
    image_points = np.ascontiguousarray(pixels, float).reshape(-1, 1, 2)
    undistorted = cv2.undistortPointsIter(
        image_points, camera.matrix, distortion, None, None, _EXACT
    )
    rays = np.asarray(undistorted, float).reshape(-1, 2)
    ahead = np.column_stack([rays, np.ones(len(rays))])
    again = project(camera, ahead, np.eye(3), np.zeros(3))
    rays[~(np.abs(again - pixels.reshape(-1, 2)).max(axis=1) < 1e-3)] = np.nan
    return rays


def poses(points: Array, rays: Array) -> list[tuple[Array, Array]]:
    """Return the refined rotation and shift of each camera pose that maps points (n, 3) to directions (n, 2).

    For coplanar points, two poses can fit. In this case the result contains both (IPPE, Collins and Bartoli 2014), and
    may contain one of them twice.
    """
    centre = points.mean(axis=0)
    _, spread, axes = np.linalg.svd(points - centre)
    flat = spread[2] < 1e-6 * spread[0]
    if np.linalg.det(axes) < 0.0:
        axes[2] = -axes[2]
    own = (points - centre) @ axes.T
    # Coplanar points need both methods: IPPE fails if the vanishing line of their plane is exactly parallel to an axis,
    # and SQPNP returns only one of the two poses.
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
    """Return a marker's cells including its frame, shape (n, n), rows from the top; True is white."""
    markers = _dictionary(dictionary)
    side = markers.markerSize + _BORDER
    cells: NDArray[np.bool_] = cv2.aruco.generateImageMarker(markers, number, side) > 0
    return cells


# --- calibration ----------------------------------------------------------------------------------


class Board:
    """ChArUco board: a chessboard with a marker in each white square, usable when partly visible.

    Args:
        columns, rows: numbers of columns and rows of squares.
        square: side of a square, m; the side of a marker is 0.72 of it.
        dictionary: dictionary of the markers.
    """

    def __init__(self, columns: int, rows: int, square: float, dictionary: str):
        self._board = cv2.aruco.CharucoBoard(
            (columns, rows), square, 0.72 * square, _dictionary(dictionary)
        )
        self._detector = cv2.aruco.CharucoDetector(self._board)

    def draw(self, pixels_per_square: int) -> Image:
        """Return the board as an image."""
        columns, rows = self._board.getChessboardSize()
        size = columns * pixels_per_square, rows * pixels_per_square
        return np.asarray(self._board.generateImage(size), np.uint8)

    def find(self, image: Image) -> tuple[Array, Array]:
        """Return the visible inner corners: positions on the board (n, 3) in m, and in the image (n, 2) in pixels."""
        corners, numbers, _, _ = self._detector.detectBoard(image)
        if numbers is None or len(numbers) == 0:
            return np.empty((0, 3)), np.empty((0, 2))
        places = self._board.getChessboardCorners()[numbers.ravel()]
        return np.asarray(places, float), np.asarray(corners, float).reshape(-1, 2)


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration.

    Attributes:
        camera: calibrated camera.
        error: rms reprojection error of all views, pixels.
        view_errors: rms reprojection error of each view, pixels, shape (views,).
        focal_deviation: standard deviation of the focal length fx, pixels.
    """

    camera: CameraModel
    error: float
    view_errors: Array
    focal_deviation: float


def calibrate(views: Sequence[tuple[Array, Array]], size: tuple[int, int]) -> Calibration:
    """Calibrate a camera, with the model plumb_bob, from views of a board.

    Args:
        views: results of `Board.find`.
        size: image size (width, height), pixels.
    """
    places = [place.astype(np.float32) for place, _ in views]
    pixels = [corners.astype(np.float32).reshape(-1, 1, 2) for _, corners in views]
    error, matrix, distortion, _, _, deviations, _, errors = cv2.calibrateCameraExtended(
        places, pixels, size, None, None
    )
    camera = CameraModel(
        *size,
        (float(matrix[0, 0]), float(matrix[1, 1])),
        (float(matrix[0, 2]), float(matrix[1, 2])),
        "plumb_bob",
        tuple(float(value) for value in distortion.ravel()[:5]),
    )
    return Calibration(camera, float(error), np.asarray(errors).ravel(), float(deviations[0, 0]))


# --- images ---------------------------------------------------------------------------------------


def read_image(path: Path) -> Image:
    """Read an image file as grey. Raises ImageError."""
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ImageError(f"{path} cannot be read as an image")
    return np.asarray(image, np.uint8)


def decode_image(data: bytes) -> Image:
    """Decode the bytes of a JPEG, PNG or other image file as grey. Raises ImageError."""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    if image is None:
        raise ImageError(f"{len(data)} bytes cannot be decoded as an image")
    return np.asarray(image, np.uint8)


def write_image(path: Path, image: Image) -> None:
    """Write an image, grey or (height, width, 3) blue, green, red, in the format of the file name's extension.

    Raises ImageError.
    """
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
    """Return the pixels of a sensor_msgs/Image, whose rows are step bytes apart, as a grey image."""
    if encoding not in _CHANNELS:
        raise ImageError(
            f"images in {encoding!r} are not supported: set the camera to one of {', '.join(_CHANNELS)}"
        )
    used = width * _CHANNELS[encoding]
    if step < used or len(data) < height * step:
        raise ImageError(
            f"an image of {width} x {height} in {encoding} with {len(data)} bytes is truncated"
        )
    rows = data[: height * step].reshape(height, step)[:, :used]
    if encoding == "mono8":
        return np.ascontiguousarray(rows)
    pixels = np.ascontiguousarray(rows).reshape(height, width, _CHANNELS[encoding])
    return np.asarray(cv2.cvtColor(pixels, _TO_GREY[encoding]), np.uint8)


class VideoSource:
    """Video file or V4L2 camera, read image by image. Raises ImageError if it cannot be opened."""

    def __init__(self, source: str):
        self._source = source
        device = source.startswith("/dev/")
        backend = cv2.CAP_V4L2 if device else cv2.CAP_FFMPEG
        self._capture = cv2.VideoCapture(source, backend)
        if not self._capture.isOpened():
            hint = (
                "is it connected, and not in use by another program?"
                if device
                else "is it a video?"
            )
            raise ImageError(f"{source} cannot be opened: {hint}")

    @property
    def rate(self) -> float:
        """Frame rate stored in the video, Hz; 0 if unknown."""
        return float(self._capture.get(cv2.CAP_PROP_FPS))

    def request_format(self, width: int, height: int, rate: float) -> None:
        """Request an image size (pixels) and a rate (Hz, 0: default) from a camera. The camera may use other values."""
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if rate:
            self._capture.set(cv2.CAP_PROP_FPS, rate)

    def read(self) -> tuple[Image, float] | None:
        """Return the next grey image and its time (s) in the video; None at the end."""
        success, image = self._capture.read()
        if not success:
            return None
        time = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) * 1e-3
        plain = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return np.asarray(plain, np.uint8), time

    def close(self) -> None:
        """Close the file or device."""
        self._capture.release()


# --- drawing --------------------------------------------------------------------------------------

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Label:
    """Outline, pixels, shape (n, 2), with a text above its upper left corner; colour is (blue, green, red)."""

    outline: Array
    text: str
    colour: Colour


def draw(image: Image, labels: Sequence[Label], title: Sequence[str]) -> Image:
    """Return a colour image with labels, and with the lines of ``title`` in its upper left corner."""
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
