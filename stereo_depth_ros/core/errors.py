# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of the package: one root, and what each is about, what was found, what is allowed and what to do as fields."""

from __future__ import annotations

from typing import TypeVar

__all__ = [
    "BagError",
    "CalibrationError",
    "ConfigError",
    "GraphError",
    "ImageError",
    "MessageError",
    "OutputError",
    "StereoDepthError",
    "TopicError",
]

ErrorT = TypeVar("ErrorT", bound="StereoDepthError")


class StereoDepthError(Exception):
    """Root of everything this package raises on purpose; as text ``subject: problem: remedy``.

    Attributes:
        problem: what is wrong, in a sentence with the value and the limit.
        subject: what the problem is about: a topic, a file, a camera, a parameter; empty where the problem says it.
        value: what was found.
        limit: what is allowed.
        remedy: what to do about it.
        settings: names of arguments or parameters that the remedy is about. The command line adds its options of these
            names, a node its parameters.
    """

    def __init__(
        self,
        problem: str,
        *,
        subject: str = "",
        value: object = None,
        limit: object = None,
        remedy: str = "",
        settings: tuple[str, ...] = (),
    ) -> None:
        super().__init__(problem)
        self.problem = problem
        self.subject = subject
        self.value = value
        self.limit = limit
        self.remedy = remedy
        self.settings = settings

    def __str__(self) -> str:
        return ": ".join(part for part in (self.subject, self.problem, self.remedy) if part)

    def about(self: ErrorT, subject: object, remedy: str | None = None) -> ErrorT:
        """The same error about something larger, which is named first; with another remedy where one is given."""
        return type(self)(
            self.problem,
            subject=f"{subject}: {self.subject}" if self.subject else str(subject),
            value=self.value,
            limit=self.limit,
            remedy=self.remedy if remedy is None else remedy,
            settings=self.settings,
        )


class ConfigError(StereoDepthError):
    """A parameter has an unknown name, a wrong type, a value out of range, or contradicts another."""


class CalibrationError(StereoDepthError):
    """Camera matrices or camera infos that cannot describe this stereo rig."""


class ImageError(StereoDepthError):
    """Pixels that cannot be used: wrong shape, dtype, or sizes that disagree."""


class MessageError(StereoDepthError):
    """A message whose fields contradict each other, or that this package does not read."""


class BagError(StereoDepthError):
    """A bag, a dataset or another file that cannot be opened, read or written."""


class OutputError(BagError):
    """A file that cannot be written, or that would destroy what is read or what is there."""


class TopicError(StereoDepthError):
    """Topics that are missing, ambiguous, equal, or of the wrong type."""


class GraphError(StereoDepthError):
    """The ROS graph is not there, a node of it ended, or a topic has nobody at its other end."""
