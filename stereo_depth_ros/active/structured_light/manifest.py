# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The manifest patterns.json of a sequence of patterns: read and written."""

from __future__ import annotations

import json
from pathlib import Path

from stereo_depth_ros.active.structured_light.patterns import PatternSequence
from stereo_depth_ros.core.errors import BagError, ConfigError
from stereo_depth_ros.core.text_files import read_text

__all__ = ["MANIFEST", "manifest_text", "read_manifest"]

MANIFEST = "patterns.json"
_REMEDY = "name the patterns.json that `stereo-depth patterns` writes"


def manifest_text(sequence: PatternSequence) -> str:
    """The content of the manifest, with one image a line."""
    values = sequence.to_json()
    images = ",\n".join(f"    {json.dumps(image)}" for image in values["images"])
    return f'{{\n  "projector": {json.dumps(values["projector"])},\n  "images": [\n{images}\n  ]\n}}\n'


def read_manifest(path: Path) -> PatternSequence:
    """The sequence of a manifest, written by ``stereo-depth patterns`` or by hand.

    Raises:
        BagError: not a readable file, or not JSON.
        ConfigError: JSON that is not a sequence; the subject is the file and the image.
    """
    text = read_text(path, BagError, _REMEDY)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        where = f" in line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise BagError(f"is not JSON{where}", subject=str(path), limit="JSON", remedy=_REMEDY) from error
    try:
        return PatternSequence.from_json(values)
    except ConfigError as error:
        raise error.about(path) from error
