# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services of type std_srvs/Trigger: their response is the text of an action, or its error."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from stereo_depth_ros.core.errors import StereoDepthError
from stereo_depth_ros.nodes.base import StereoNode
from stereo_depth_ros.nodes.log import log_error, log_info
from stereo_depth_ros.nodes.message_types import message_class
from stereo_depth_ros.nodes.parameters import error_text

__all__ = ["add_trigger"]


def add_trigger(node: StereoNode, name: str, act: Callable[[], str]) -> None:
    """A service of the interface that responds with the text of ``act``, or with the error it raises, and logs it."""

    def respond(_: Any, response: Any) -> Any:
        try:
            response.success, response.message = True, act()
        except StereoDepthError as error:
            response.success, response.message = False, error_text(error)
        log = log_info if response.success else log_error
        log(node.get_logger(), response.message)
        return response

    node.create_service(message_class(node.interface.services[name]), name, respond)
