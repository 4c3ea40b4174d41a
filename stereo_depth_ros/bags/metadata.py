# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The metadata.yaml of a rosbag2 folder: which files it lists; what else stands in it, the files say themselves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stereo_depth_ros.bags.losses import cause_text
from stereo_depth_ros.core.errors import BagError
from stereo_depth_ros.core.quoted import quoted
from stereo_depth_ros.core.safe_yaml import load_yaml
from stereo_depth_ros.core.text_files import read_text

__all__ = ["METADATA", "listed_files"]

METADATA = "metadata.yaml"
_LONGEST = 2**18  # bytes: it is read completely, at about 100 kB a second


def listed_files(folder: Path) -> tuple[list[Path], str]:
    """The files of a bag in the order of its metadata.yaml.

    Returns:
        The files, none where it lists none or cannot be read, and in the latter case what is wrong with it, a part of
        a sentence about the bag. A recorder that was killed has left none, of which nothing is said.

    Raises:
        BagError: the bag is compressed by another method than zstd.
    """
    path = folder / METADATA
    if not path.exists():
        return [], ""
    try:
        information = _information(path)
        names = information["relative_file_paths"]
        if not isinstance(names, list) or not all(isinstance(name, str) and Path(name).name for name in names):
            raise ValueError("relative_file_paths is not a list of names")
    except KeyError as error:
        return [], _ignored(f"it has no {error}")
    except BagError as error:
        return [], _ignored(f"it {error.problem}")
    except ValueError as error:
        return [], _ignored(cause_text(error))
    method = information.get("compression_format")
    if isinstance(method, str) and method not in ("", "zstd"):
        raise BagError(
            f"is compressed by {quoted(method)}, only zstd is supported",
            subject=str(folder),
            value=method,
            limit="zstd",
            remedy="convert it with `ros2 bag convert`",
        )
    return [folder / Path(name).name for name in names], ""


def _ignored(why: str) -> str:
    return f"has a {METADATA} that is ignored ({why}): the bag files of the folder are read"


def _information(path: Path) -> dict[str, Any]:
    content = load_yaml(read_text(path, BagError, "copy it again", _LONGEST))
    information = content["rosbag2_bagfile_information"] if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise ValueError("it is not the metadata of a bag")
    return information
