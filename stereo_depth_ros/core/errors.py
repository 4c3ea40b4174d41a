# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exceptions of the package, with subject, value, limit and remedy as fields."""

from __future__ import annotations

from typing import TypeVar

__all__ = [
    "BagError",
    "CalibrationError",
    "CameraOrderError",
    "ConfigError",
    "GraphError",
    "ImageError",
    "MessageError",
    "OutputError",
    "RegistrationError",
    "StereoDepthError",
    "TopicError",
    "TransformError",
]

ErrorT = TypeVar("ErrorT", bound="StereoDepthError")


class StereoDepthError(Exception):
    """Base class of the exceptions of this package; as text ``subject: problem: remedy``.

    Attributes:
        problem: one sentence that states the value and the limit.
        subject: a topic, file, camera or parameter; empty if the problem names it.
        value: the value found.
        limit: the values allowed.
        remedy: what to do.
        settings: names of the arguments or parameters that the remedy concerns. The command line adds its options of
            these names, a node its parameters.
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
        """The same error with ``subject`` prepended, and with another remedy if one is given."""
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
    """Camera matrices or camera infos that do not describe a valid stereo rig."""


class ImageError(StereoDepthError):
    """Images that cannot be used: wrong shape or dtype, or different sizes."""


class CameraOrderError(ImageError):
    """The images show that left and right are swapped, so that no disparity of the whole stream is right."""


class MessageError(StereoDepthError):
    """A message with contradictory fields, or of a type or encoding that is not supported."""


class BagError(StereoDepthError):
    """A bag, a dataset or another file that cannot be opened, read or written."""


class OutputError(BagError):
    """A file that cannot be written, or that would destroy what is read or what is there."""


class RegistrationError(StereoDepthError):
    """Surfaces whose relative pose cannot be found: too little in common, or a motion that they do not determine."""


class TopicError(StereoDepthError):
    """Topics that are missing, ambiguous, equal, or of the wrong type."""


class GraphError(StereoDepthError):
    """The ROS graph is not available, a node has exited, or a topic has no publisher or subscriber."""


class TransformError(StereoDepthError):
    """A transform between two frames that is missing, not known at a time, or not one."""
