# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Header stamp of a serialized message: read, replaced and formatted without deserialization."""

from __future__ import annotations

import struct

from stereo_depth_ros.core.errors import MessageError
from stereo_depth_ros.messages.types import NS_PER_S, nanoseconds

__all__ = ["cdr_stamp_ns", "stamp_text", "with_stamp", "without_stamp"]

_HEADER_BYTES, _STAMP_END = 4, 12  # encapsulation, then sec and nanosec of the leading header


def cdr_stamp_ns(data: bytes) -> int:
    """Header stamp in the CDR bytes of a message that starts with std_msgs/Header, integer nanoseconds.

    Raises:
        MessageError: fewer bytes than the stamp needs, or a stamp of a whole second or more in its nanoseconds.
    """
    return nanoseconds(*_stamp_format(data).unpack_from(data, _HEADER_BYTES))


def with_stamp(data: bytes, stamp_ns: int) -> bytes:
    """The same CDR bytes with another header stamp.

    Raises:
        MessageError: fewer bytes than the stamp needs.
    """
    stamp = _stamp_format(data).pack(*divmod(stamp_ns, NS_PER_S))
    return b"".join((data[:_HEADER_BYTES], stamp, memoryview(data)[_STAMP_END:]))


def without_stamp(data: bytes) -> bytes:
    """The CDR bytes after the header stamp: equal for camera infos that differ in their stamps only."""
    return data[_STAMP_END:]


def stamp_text(stamp_ns: int) -> str:
    """A stamp in seconds with all nine decimals, more than a float can represent."""
    return f"{stamp_ns // NS_PER_S}.{stamp_ns % NS_PER_S:09d}"


def _stamp_format(data: bytes) -> struct.Struct:
    if len(data) < _STAMP_END:
        raise MessageError(
            f"serialized message of {len(data)} bytes, a header stamp ends at byte {_STAMP_END}",
            value=len(data),
            limit=_STAMP_END,
            remedy="the bag is damaged",
        )
    # The second byte of the encapsulation is odd for little-endian (OMG DDSI-RTPS 2.2, 10.5).
    return struct.Struct("<iI" if data[1] & 1 else ">iI")
