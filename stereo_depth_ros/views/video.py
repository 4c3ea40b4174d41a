# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Video files of views: MPEG-4 in an MP4 container."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from types import TracebackType

import cv2

from stereo_depth_ros.core.errors import OutputError
from stereo_depth_ros.core.types import U8
from stereo_depth_ros.files.output import OutputFile, as_output_errors
from stereo_depth_ros.views.color_order import as_bgr

__all__ = ["VideoFile"]


class VideoFile:
    """A video that appears when its ``with`` block has ended without an error.

    MPEG-4 Part 2, the codec that all builds of OpenCV have. Sides of odd length lose their last row or column.

    Args:
        path: the file, .mp4.
        rate_hz: frames per second.
        overwrite: replace an existing file.

    Raises:
        OutputError: it exists and ``overwrite`` is false, or it cannot be written.
    """

    def __init__(self, path: Path, rate_hz: float, *, overwrite: bool = False) -> None:
        self._output = OutputFile(path, overwrite=overwrite, make_folders=True)
        self._rate_hz = rate_hz
        # OpenCV chooses the container by the suffix and writes files only by their names.
        self._folder = tempfile.TemporaryDirectory(prefix="stereo_depth_ros_")
        self._file = Path(self._folder.name) / "video.mp4"
        self._writer: cv2.VideoWriter | None = None
        self._size = (0, 0)
        self.frames = 0

    def add(self, image: U8) -> None:
        """One more frame, uint8 (H, W) or (H, W, 3) BGR, of the size of the first one.

        Raises:
            OutputError: OpenCV has no such codec, or the size changed.
        """
        height, width = (size // 2 * 2 for size in image.shape[:2])
        if self._writer is None:
            self._size = (width, height)
            codec = cv2.VideoWriter.fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._file), cv2.CAP_FFMPEG, codec, self._rate_hz, self._size)
        is_same = (width, height) == self._size
        if not self._writer.isOpened() or not is_same:
            raise OutputError(
                "OpenCV cannot write MPEG-4" if is_same else f"the size changes to {width}x{height}",
                subject=str(self._output.path),
                value=(width, height),
                limit=self._size,
                remedy="write an image, .png, of each part",
            )
        self._writer.write(as_bgr(image[:height, :width]))
        self.frames += 1

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._writer is not None:
                self._writer.release()
            if kind is None and self.frames:
                with as_output_errors(self._output.path), self._file.open("rb") as video:
                    shutil.copyfileobj(video, self._output.file)
                self._output.close()
        finally:
            self._output.discard()
            self._folder.cleanup()
