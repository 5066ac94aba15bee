# SPDX-License-Identifier: Apache-2.0
"""OpenCV interface: marker detection, camera geometry, calibration and image files.

No other module imports cv2. Images are grey arrays of shape (height, width) unless stated otherwise. Coordinates in
pixels are (column, row), with (0, 0) at the centre of the first pixel.
"""

from collections.abc import Iterator, Sequence
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
_SAMPLES = (
    10  # samples per cell of the upright image of a marker, which has one further cell on each side
)
#: Part of an edge that determines its line, as shares of its length. Blur rounds the corners.
_USED = np.array([0.1, 0.9])
_FEWEST = 8  # smallest number of points of an edge that determine its line
#: Smallest rise of the grey level from the black frame to the white around it that counts as an edge.
_LEAST_RISE = 12.0
_REFINEMENTS = 2  # number of refinements of the corners, each from the corners of the previous one
_OUTLIER = 0.5  # samples; points of an edge that are farther from its line hardly count
_BORDER = 2  # number of cells of the black frame in each row of a marker, in addition to the bits
#: Rotation by a quarter turn that moves the right edge of an image to its top, as `np.rot90` does.
_TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


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
        return [
            self._refined(image, int(number), quadrilateral[0].astype(float))
            for number, quadrilateral in zip(numbers.ravel(), quadrilaterals, strict=True)
        ]

    def _refined(self, image: Image, number: int, first: Array) -> Detection:
        """Return a marker with refined corners, or with OpenCV's corners if it has no clear edges."""
        corners, width = first, np.inf
        for _ in range(_REFINEMENTS):
            if np.isfinite(corners).all():
                corners, width = _refine(image, corners, self._cells)
        cell = np.hypot(*(first[1] - first[0])) / self._cells
        # Refined corners far from OpenCV's corners belong to other edges.
        if np.abs(corners - first).max() < cell:
            return Detection(number, corners, width)
        return Detection(number, first, np.inf)


def _refine(image: Image, corners: Array, cells: int) -> tuple[Array, float]:
    """Return refined corners, shape (4, 2), NaN without clear edges, and the width of the edges, cells.

    A corner is the intersection of the lines through two adjacent edges. A point of an edge is where the grey level is
    half way between the frame and the white around it. Blur does not move such points, but moves OpenCV's corners
    inwards. A line through many such points is several times more accurate than OpenCV's corners.
    """
    half = 0.5 * cells * _SAMPLES
    square = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    to_image = cv2.getPerspectiveTransform(square.astype(np.float32), corners.astype(np.float32))
    middle, size = half + _SAMPLES - 0.5, (cells + 2) * _SAMPLES
    from_first = np.array([[1.0, 0.0, -middle], [0.0, 1.0, -middle], [0.0, 0.0, 1.0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    upright = cv2.warpPerspective(
        image, to_image @ from_first, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    profiles = [_profiles(np.rot90(upright, turn), cells) for turn in range(4)]
    lines = [
        np.linalg.matrix_power(_TURN, turn).T @ _line(shares, half)
        for turn, shares in enumerate(profiles)
    ]
    meetings = np.array([np.cross(lines[side - 1], lines[side]) for side in range(4)])
    refined = cv2.perspectiveTransform((meetings[:, :2] / meetings[:, 2:])[None], to_image)[0]
    # Opposite sides are blurred alike. The width is that of the wider pair.
    return refined, max(_width(profiles[0::2]), _width(profiles[1::2]))


def _profiles(upright: Image, cells: int) -> Array:
    """Return grey levels across the upper edge, shape (across, along), scaled from 0 (frame) to 1 (white around it).

    A profile without an edge is NaN.
    """
    first, last = np.rint((1.0 + _USED * cells) * _SAMPLES).astype(int)
    levels = upright[1 : 2 * _SAMPLES - 1, first:last][::-1].astype(float)
    low, high = levels[:3].mean(axis=0), levels[-3:].mean(axis=0)
    shares: Array = (levels - low) / np.where(high - low > _LEAST_RISE, high - low, np.nan)
    return shares


def _line(shares: Array, half: float) -> Array:
    """Return the line (a, b, c), a * x + b * y + c = 0, through an upper edge; NaN if it has too few points.

    Coordinates are samples from the middle of the marker, whose side is twice ``half``.
    """
    after = (shares > 0.5).argmax(axis=0)  # 0 without an edge, or if it begins above 0.5
    columns = np.flatnonzero(after)
    if len(columns) < _FEWEST:
        return np.full(3, np.nan)
    after = after[columns]
    before, beyond = shares[after - 1, columns], shares[after, columns]
    outwards = after - 1 + (0.5 - before) / (beyond - before)
    across, along = shares.shape
    points = np.column_stack(
        [columns - 0.5 * (along - 1), 0.5 * (across - 1) - outwards - half]
    ).astype(np.float32)
    fit = cv2.fitLine(points, cv2.DIST_WELSCH, _OUTLIER, 1e-3, 1e-3)
    dx, dy, x, y = fit.ravel().astype(float)
    return np.array([dy, -dx, y * dx - x * dy])


def _width(profiles: Sequence[Array]) -> float:
    """Return the width of edges from 10 to 90 % of the rise, cells, from all their profiles; infinite without any."""
    every = np.concatenate(profiles, axis=1)
    clear = every[:, np.isfinite(every).all(axis=0)]
    if not clear.size:
        return np.inf
    share = np.clip(clear.mean(axis=1), 0.0, 1.0)
    # The area under s(1 - s) of a linear ramp of width w is w / 6, and 10 to 90 % are 0.8 w.
    return float(0.8 * 6.0 * (share * (1.0 - share)).sum() / _SAMPLES)


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
    # Coplanar points need both methods: IPPE fails if the vanishing line of their plane is exactly parallel to an axis,
    # and SQPNP returns only one of the two poses.
    methods = [cv2.SOLVEPNP_SQPNP]
    if np.linalg.matrix_rank(points - points.mean(axis=0), 1e-6) < 3:
        methods.append(cv2.SOLVEPNP_IPPE)
    candidates = []
    for method in methods:
        _, turns, shifts, _ = cv2.solvePnPGeneric(points, rays, _UNIT, None, flags=method)
        for turn, shift in zip(turns, shifts, strict=True):
            if np.isfinite([turn, shift]).all():
                better = cv2.solvePnPRefineLM(points, rays, _UNIT, None, turn, shift)
                candidates.append((cv2.Rodrigues(better[0])[0], better[1].ravel()))
    return candidates


# --- dictionaries ---------------------------------------------------------------------------------


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_image(dictionary: str, number: int, pixels_per_cell: int = 50) -> Image:
    """Return the image of a marker with its black frame, without a white margin."""
    markers = _dictionary(dictionary)
    side = (markers.markerSize + _BORDER) * pixels_per_cell
    return np.asarray(cv2.aruco.generateImageMarker(markers, number, side), np.uint8)


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
        size,
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


#: Channels of the encodings of sensor_msgs/Image, and the conversion to grey.
_ENCODINGS = {
    "mono8": (1, None),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "yuv422": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2GRAY_YUY2),
}


def grey(data: NDArray[np.uint8], height: int, width: int, step: int, encoding: str) -> Image:
    """Return the pixels of a sensor_msgs/Image, whose rows are step bytes apart, as a grey image."""
    if encoding not in _ENCODINGS:
        raise ImageError(
            f"images in {encoding!r} are not supported: set the camera to one of {', '.join(_ENCODINGS)}"
        )
    channels, conversion = _ENCODINGS[encoding]
    used = width * channels
    if step < used or len(data) < height * step:
        raise ImageError(
            f"an image of {width} x {height} in {encoding} with {len(data)} bytes is truncated"
        )
    pixels = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :used])
    if conversion is None:
        return pixels
    return np.asarray(cv2.cvtColor(pixels.reshape(height, width, channels), conversion), np.uint8)


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

    def images(self) -> Iterator[tuple[Image, float]]:
        """Yield each grey image with its time (s) in the video, or of its exposure by the camera's clock."""
        while True:
            success, image = self._capture.read()
            if not success:
                return
            time = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) * 1e-3
            plain = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            yield np.asarray(plain, np.uint8), time

    def close(self) -> None:
        """Close the file or device."""
        self._capture.release()
