# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Recording from a thread: order, nothing to record into, a disk that fails."""

from __future__ import annotations

from pathlib import Path

import pytest

from stereo_depth_ros.bags.reader import BagReader
from stereo_depth_ros.bags.writer import BagWriter
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.nodes.replay.recorder import Recorder

TYPE = "sensor_msgs/msg/Image"


def test_all_messages_are_written_in_order(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with Recorder(path) as recorder:
        for index in range(200):  # more than the queue holds
            recorder.write("/image", TYPE, bytes([index]) * 1000, index)
    with BagReader(path) as reader:
        assert [(m.log_time_ns, m.data[0]) for m in reader.messages()] == [(index, index) for index in range(200)]


def test_without_a_path_nothing_is_recorded(tmp_path: Path) -> None:
    with Recorder(None) as recorder:
        recorder.write_metadata("stereo_depth_ros", {"version": "1"})
        recorder.write("/image", TYPE, b"1", 1)
    assert list(tmp_path.iterdir()) == []


def test_interrupted_recording_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), Recorder(tmp_path / "out.mcap") as recorder:
        recorder.write("/image", TYPE, b"1", 1)
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_disk_that_fails_ends_the_recording_with_the_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(BagWriter, "write_raw", fail)
    with (
        pytest.raises(BagError, match=r"recording stopped: the disk is full: free space on the disk"),
        Recorder(tmp_path / "out.mcap") as recorder,
    ):
        for index in range(200):  # the queue is emptied, so this does not wait for ever
            recorder.write("/image", TYPE, b"1", index)
    assert list(tmp_path.iterdir()) == []
