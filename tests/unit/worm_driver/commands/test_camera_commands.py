# SPDX-License-Identifier: Apache-2.0
"""The commands markers, calibrate_camera and track."""

import csv
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from camera_rig import LENGTH, SETTINGS, SETUP_FILE
from rendered_images import WHOLE, CameraSettings, Pattern, RenderedCamera, axes_of

from worm_driver.commands import calibrate_camera, markers, track
from worm_driver.tracking.camera_model import load_camera_info
from worm_driver.tracking.vision import Board


@pytest.fixture(scope="module")
def images(tmp_path_factory) -> Path:
    """Write three images of a rear module that moves by 5 mm per image; in the last one it is hidden."""
    folder = tmp_path_factory.mktemp("images")
    camera = RenderedCamera(SETTINGS, 3)
    for index, rear in enumerate((0.0, 0.005, math.nan)):
        cv2.imwrite(str(folder / f"{index}.png"), camera.image(rear, LENGTH))
    (folder / "times.csv").write_text("file,time_s\n0.png,1.0\n1.png,1.1\n2.png,1.2\n")
    return folder


def tracked(*options: object) -> int:
    """Return the exit status of track with the installed setup."""
    return track.main(["--setup", str(SETUP_FILE), *map(str, options)])


def complaint(capsys) -> str:
    """Return the only line on standard error."""
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_track_writes_the_table(images, tmp_path, capsys):
    output = tmp_path / "out.csv"
    assert tracked("--images", images, "--output", output) == 0
    rows = list(csv.DictReader(output.open()))
    columns = ["time_s", "rear_position_m", "front_position_m", "length_m", "reason"]
    assert list(rows[0]) == columns
    numbers = np.array([[float(row[name]) for name in columns[:4]] for row in rows])
    assert numbers[:, 0] == pytest.approx([1.0, 1.1, 1.2])
    assert numbers[:2, 1] == pytest.approx([0.0, 0.005], abs=2e-4)
    assert numbers[:, 2] == pytest.approx([LENGTH] * 3, abs=2e-4)
    assert np.isnan(numbers[2, [1, 3]]).all()
    assert [row["reason"] for row in rows] == ["", "", "rear marker 0 is not found"]
    reported = capsys.readouterr().out
    assert f"{output}: both modules in 2 of 3 images" in reported
    assert float(re.search(r"fit within ([\d.]+) px", reported)[1]) < 0.2


def test_a_film_gives_what_its_images_give(images, tmp_path):
    video = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (1280, 720))
    for index in range(3):
        writer.write(cv2.imread(str(images / f"{index}.png")))
    writer.release()
    output = tmp_path / "out.csv"
    assert tracked("--video", video, "--output", output) == 0
    rows = list(csv.DictReader(output.open()))
    assert [float(row["time_s"]) for row in rows] == pytest.approx([0.0, 0.1, 0.2])
    assert float(rows[1]["rear_position_m"]) == pytest.approx(0.005, abs=3e-4)


@pytest.mark.parametrize(("paper", "size"), [("a4", (210.0, 297.0)), ("letter", (215.9, 279.4))])
def test_a_page_has_its_true_size(tmp_path, paper, size):
    output = tmp_path / "markers.pdf"
    assert (
        markers.main(["--setup", str(SETUP_FILE), "--paper", paper, "--output", str(output)]) == 0
    )
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", output.read_bytes())
    assert [float(side) / 72 * 25.4 for side in box.groups()] == pytest.approx(size, abs=0.01)


def test_black_squares_and_the_ruler_have_their_true_size(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(markers, "_write", lambda _, sheets: drawn.extend(sheets))
    assert markers.main(["--setup", str(SETUP_FILE), "--output", str(tmp_path / "m.pdf")]) == 0
    (axes,) = drawn[0].figure.axes
    to_inches = axes.transData + drawn[0].figure.dpi_scale_trans.inverted()

    def to_mm(points: np.ndarray) -> np.ndarray:
        return 25.4 * to_inches.transform(points)

    assert len(axes.images) == 2 + len(SETTINGS.reference)
    for square in axes.images:
        corners = to_mm(np.reshape(square.get_extent(), (2, 2)).T)
        assert np.ptp(corners, axis=0) == pytest.approx([1e3 * SETTINGS.marker_size] * 2, abs=1e-6)
    lengths = [np.ptp(to_mm(line.get_xydata()), axis=0)[0] for line in axes.lines]
    assert max(lengths) == pytest.approx(100.0, abs=1e-6)


def test_a_marker_that_does_not_fit_on_the_paper_is_rejected(tmp_path, capsys):
    large = tmp_path / "setup.yaml"
    given = yaml.safe_load(SETUP_FILE.read_text())
    given["camera_info"] = str(SETUP_FILE.parent / given["camera_info"])
    places = {10: [0.0, 0.0, 0.0], 11: [1.0, 0.0, 0.0]}
    large.write_text(yaml.safe_dump({**given, "marker_size_m": 0.3, "reference": places}))
    assert markers.main(["--setup", str(large), "--output", str(tmp_path / "m.pdf")]) == 2
    assert "does not fit on the paper" in complaint(capsys)
    assert not (tmp_path / "m.pdf").exists()


def board_image(settings: CameraSettings) -> np.ndarray:
    """Return an image of the printed board in the plane y = 0."""
    columns, rows, square, dictionary = markers.BOARD
    cells = Board(columns, rows, square, dictionary).draw(50) / 255.0
    pattern = Pattern(0.05 + 0.9 * cells, (square / 50, square / 50))
    camera, size = RenderedCamera(settings, 1), (settings.height, settings.width)
    levels = 180.0 * camera.scene(np.full(size, 0.7), WHOLE, 0.0, pattern, np.zeros((1, 2)))
    noise = np.random.default_rng(1).normal(0.0, 1.5, levels.shape)
    return np.clip(levels + noise, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def board_views(tmp_path_factory) -> Path:
    """Return ten views of the board by the rendered camera's lens, at half its size, from all around."""
    folder = tmp_path_factory.mktemp("board")
    lens = replace(SETTINGS, width=640, height=360, focal=505.0, centre=(326.0, 176.0))
    tilts = [(0.0, 0.0), (0.5, 0.1), (-0.5, 0.1), (0.1, 0.5), (-0.1, -0.5)] * 2
    aims = [(0, 0), (0.06, 0.05), (-0.06, 0.05), (0.06, -0.05), (-0.06, -0.05)]
    for index, (yaw, pitch) in enumerate(tilts):
        distance = 0.24 if index < 5 else 0.3
        view = replace(lens, yaw=yaw, pitch_angle=pitch, roll=0.3 * (index % 3))
        x, z = aims[(index * 2) % 5]
        place = np.array([x, 0.0, z]) - distance * axes_of(view)[2]
        image = board_image(replace(view, position=tuple(place)))
        cv2.imwrite(str(folder / f"{index}.png"), image)
    return folder


def test_the_lens_is_found_again(board_views, tmp_path, capsys):
    output = tmp_path / "camera.yaml"
    arguments = ["--images", str(board_views), "--output", str(output)]
    assert calibrate_camera.main(arguments) == 0
    reported = capsys.readouterr()
    assert float(re.search(r"reprojection error ([\d.]+) px", reported.out)[1]) < 0.3
    camera = load_camera_info(output)
    assert camera.focal == pytest.approx((505.0, 505.0), rel=5e-3)
    assert camera.centre == pytest.approx((326.0, 176.0), abs=3.0)
    assert camera.distortion[0] == pytest.approx(SETTINGS.distortion[0], abs=0.05)


def test_too_few_views_are_rejected(images, tmp_path, capsys):
    output = tmp_path / "camera.yaml"
    assert calibrate_camera.main(["--images", str(images), "--output", str(output)]) == 2
    assert "the board was found in 0 different images; at least 8" in complaint(capsys)
    assert not output.exists()
