# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message payloads reused from frame to frame."""

from __future__ import annotations

from typing import Any

from stereo_depth_ros.core.types import U8
from stereo_depth_ros.messages.types import MessageTypes

__all__ = ["PayloadPool"]


class PayloadPool:
    """Reused message payloads: a message is valid until the next of its kind is built."""

    def __init__(self, types: MessageTypes) -> None:
        self._types = types
        self._payloads: dict[tuple[str, int], tuple[Any, U8]] = {}

    def get(self, kind: str, nbytes: int) -> tuple[Any, U8]:
        """The payload of this kind and size, zeroed when first allocated."""
        key = (kind, nbytes)
        if key not in self._payloads:
            self._payloads = {k: v for k, v in self._payloads.items() if k[0] != kind}
            self._payloads[key] = self._types.payload(nbytes)
        return self._payloads[key]
