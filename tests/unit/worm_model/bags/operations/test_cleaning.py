# SPDX-License-Identifier: Apache-2.0
"""Data that shows where a bag was recorded is removed, and nothing else."""

import json
import sys
from pathlib import Path

import pytest

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import encode
from worm_model.bags.formats.contents import AttachedFile
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.opening import open_bag
from worm_model.bags.operations.cleaning import Cleaner
from worm_model.bags.recording.run_manifest import run_manifest
from worm_model.commands import bags

SECRETS = (b"labpc7", b"/home", b"jane", b"/dev")


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ("record --output /home/jane/bags/run_1", "record --output run_1"),
        ("port: '/dev/serial/by-id/usb-FTDI_1' lost", "port: 'usb-FTDI_1' lost"),
        ("labpc7: no answer", "host: no answer"),
        ("~/robot/a.yaml", "a.yaml"),
        (
            "/worm/tracker is late, /worm/twin/state too",
            "/worm/tracker is late, /worm/twin/state too",
        ),
        ("12 m/s, 3/4, and/or, labpc70", "12 m/s, 3/4, and/or, labpc70"),
        ("", ""),
    ],
)
def test_texts(text: str, cleaned: str):
    assert Cleaner("labpc7", ["/worm/tracker"]).text(text) == cleaned


def record(path: Path) -> Path:
    """Write a bag with the host and paths in its records, its parameter file and its messages."""
    status = topic_of("/worm/status", "diagnostic_msgs/msg/DiagnosticStatus")
    power = topic_of("/worm/power", "worm_msgs/msg/Power")
    with new_bag(path, {"recovered_from": "run_1"}) as writer:
        run = {"host": "labpc7", "command": "record -p /home/jane/robot.yaml", "seed": "4"}
        writer.add_metadata("worm_run", run)
        parameters = b"port: /dev/ttyUSB0  # of labpc7\npitch: 0.0173\n"
        writer.add_attachment(AttachedFile("parameters.yaml", "application/yaml", parameters))
        (reported,) = encode(status, 1, {}, {"message": "/dev/ttyUSB0 of labpc7 is gone"})
        (plain,) = encode(status, 1, {}, {"message": "all well"})
        (sample,) = encode(power, 1, {"power": 2.5}, {"header.frame_id": "pipe"})
        for i, (topic, data) in enumerate([(status, reported), (status, plain), (power, sample)]):
            writer.write(topic, data, i, i)
    return path


def test_a_bag_is_cleaned_and_keeps_all_else(tmp_path: Path, monkeypatch, capsys):
    bag = record(tmp_path / "bag")
    arguments = ["bags", "clean", str(bag), "--output", str(tmp_path / "clean"), "--json"]
    monkeypatch.setattr(sys, "argv", arguments)
    assert bags.main() == 0
    assert json.loads(capsys.readouterr().out) == {
        "bag": str(tmp_path / "clean"),
        "messages": 3,
        "changed": 1,
    }
    with open_bag(bag) as before, open_bag(tmp_path / "clean") as after:
        assert after.metadata["worm_run"] == {"command": "record -p robot.yaml", "seed": "4"}
        (attached,) = after.attachments()
        assert attached.data == b"port: ttyUSB0  # of host\npitch: 0.0173\n"
        old, new = list(before.messages()), list(after.messages())
        assert b"ttyUSB0 of host is gone" in new[0].data
        assert new[1:] == old[1:]
        assert new[0].log_time == old[0].log_time
        content = b"".join([m.data for m in new] + [a.data for a in after.attachments()])
        assert not any(secret in content for secret in SECRETS)
    assert not any(
        secret in (tmp_path / "clean" / "metadata.yaml").read_bytes() for secret in SECRETS
    )


def test_a_manifest_is_cleaned(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("platform.node", lambda: "labpc7")
    file = tmp_path / "robot.yaml"
    file.write_text("port: /dev/ttyUSB0\n")
    command = ["/opt/worm/record", "-p", str(file), "--anonymous"]
    manifest = run_manifest(file, None, ["pc=labpc7"], command, 0)
    cleaned = Cleaner("labpc7", ()).manifest(manifest)
    run = cleaned.metadata["worm_run"]
    assert "host" not in run
    assert run["command"] == "record -p robot.yaml --anonymous"
    assert (run["parameter_file"], run["note.pc"]) == ("robot.yaml", "host")
    assert cleaned.attachments[0].data == b"port: ttyUSB0\n"


@pytest.mark.parametrize("arguments", [[], ["clean"], ["burn"], ["clean", "no", "--output", "x"]])
def test_bad_input_ends_with_status_2_and_a_line(tmp_path: Path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["bags", *arguments])
    try:
        status = bags.main()
    except SystemExit as left:
        status = left.code
    assert status == 2
    assert capsys.readouterr().err.count("\n") == 1
