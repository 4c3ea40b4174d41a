# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A network in an ONNX file, opened once, and the execution provider of ONNX Runtime that runs it."""

from __future__ import annotations

import functools
import importlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stereo_depth_ros.core.errors import ConfigError

__all__ = ["Network", "model_error", "open_network"]

# The names in ONNX Runtime of a provider and of those that take over the operators that it lacks.
_PROVIDERS: Mapping[str, tuple[str, ...]] = {
    "cpu": ("CPUExecutionProvider",),
    "cuda": ("CUDAExecutionProvider", "CPUExecutionProvider"),
    "tensorrt": ("TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"),
    "openvino": ("OpenVINOExecutionProvider", "CPUExecutionProvider"),
}
_AUTOMATIC = ("cuda", "openvino", "cpu")  # without TensorRT, which builds its engines for minutes
_FATAL = 4  # log severity: errors are raised as exceptions


@dataclass(frozen=True, eq=False)
class Network:
    """An opened network.

    Attributes:
        model: the path of its file.
        session: of ONNX Runtime.
        provider: by which it runs: cpu, cuda, tensorrt or openvino.
        metadata: texts in the file by their names.
    """

    model: str
    session: Any
    provider: str
    metadata: Mapping[str, str]

    @property
    def inputs(self) -> Sequence[Any]:
        """Their descriptions by ONNX Runtime: name, type, shape."""
        described: Sequence[Any] = self.session.get_inputs()
        return described

    @property
    def outputs(self) -> Sequence[Any]:
        """As :attr:`inputs`."""
        described: Sequence[Any] = self.session.get_outputs()
        return described

    def number(self, name: str, low: float = -math.inf, high: float = math.inf) -> float | None:
        """A number in the metadata, None where it is not there.

        Raises:
            ConfigError: the text is not a finite number in that range.
        """
        text = self.metadata.get(name)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and low <= value <= high):
            limit = "a number" if math.isinf(low) else f"a number of {low:g} to {high:g}"
            raise model_error(
                self.model, f"has {text!r} as its {name} in the metadata, it must be {limit}", limit, "correct it"
            )
        return value

    def run(self, outputs: Sequence[str], tensors: Mapping[str, npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
        """The values of the named outputs.

        Raises:
            ConfigError: the network fails on these tensors.
        """
        shape = next(iter(tensors.values())).shape
        try:
            found = self.session.run(list(outputs), dict(tensors))
        except Exception as error:  # ONNX Runtime has no common base class of its errors
            raise model_error(
                self.model,
                f"fails on inputs of shape {shape}: {_text(error)}",
                shape,
                "export it for images of this size, or of any size",
            ) from error
        for name, value in zip(outputs, found, strict=True):
            if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
                kind = getattr(value, "dtype", type(value).__name__)
                raise model_error(
                    self.model, f"has an output {name!r} of {kind}", "a tensor of numbers", "export it as float32"
                )
        return list(found)


def open_network(model: str, provider: str, matcher: str) -> Network:
    """The network in a file; cached, as parameters are checked by opening it.

    Args:
        model: path of the file, the parameter onnx_model.
        provider: the parameter onnx_provider.
        matcher: what needs it, for the text of an error.

    Raises:
        ConfigError: no file, not a network, ONNX Runtime or the provider is missing.
    """
    if not model:
        raise ConfigError(
            f"onnx_model is empty, {matcher} needs a network",
            value=model,
            remedy="set it to the path of an .onnx file",
            settings=("onnx_model",),
        )
    if not Path(model).is_file():
        raise model_error(
            model, "is not a file", "an .onnx file", f"correct the path, relative ones begin at {Path.cwd()}"
        )
    status = Path(model).stat()
    return _network(_runtime(matcher), model, status.st_mtime_ns, status.st_size, provider)


def _runtime(matcher: str) -> Any:
    """The module onnxruntime."""
    try:
        return importlib.import_module("onnxruntime")
    except ImportError as error:
        raise ConfigError(
            f"{matcher} needs onnxruntime, which cannot be imported ({error})", remedy="pip install onnxruntime"
        ) from error


@functools.lru_cache(maxsize=2)
def _network(runtime: Any, model: str, _mtime_ns: int, _size: int, provider: str) -> Network:
    available = [name for name, names in _PROVIDERS.items() if names[0] in runtime.get_available_providers()]
    if provider != "auto" and provider not in available:
        raise ConfigError(
            f"onnx_provider = {provider} is not in the installed onnxruntime, which has {', '.join(available)}",
            value=provider,
            limit=tuple(available),
            remedy=f"use one of these, or install a build of onnxruntime with {_PROVIDERS[provider][0]}",
            settings=("onnx_provider",),
        )
    wanted = [name for name in _AUTOMATIC if name in available] if provider == "auto" else [provider]
    for name in wanted:
        session = _session(runtime, model, name, last=name == wanted[-1])
        if session is not None:
            return Network(model, session, name, dict(session.get_modelmeta().custom_metadata_map))
    raise ConfigError(
        f"onnx_provider = {provider} is in the installed onnxruntime but does not start",
        value=provider,
        limit=tuple(available),
        remedy="install its libraries and its driver in the versions that onnxruntime needs, or use cpu",
        settings=("onnx_provider",),
    )


def _session(runtime: Any, model: str, provider: str, last: bool) -> Any:
    """A session, or None where the provider does not start: ONNX Runtime then leaves it out without a word."""
    options = runtime.SessionOptions()
    options.use_deterministic_compute = True
    options.log_severity_level = _FATAL
    names = [name for name in _PROVIDERS[provider] if name in runtime.get_available_providers()]
    try:
        session = runtime.InferenceSession(model, options, providers=names, enable_fallback=0)
    except Exception as error:  # ONNX Runtime has no common base class of its errors
        if not last:
            return None
        text = _text(error)
        kind = "is not an ONNX file" if "protobuf" in text.lower() else "is not a network that can be run"
        remedy = "export it again, in one file and for the version of onnxruntime that is installed"
        raise model_error(model, f"{kind}: {text}", "an ONNX network", remedy) from error
    return session if session.get_providers()[0] == names[0] else None


def _text(error: Exception) -> str:
    """What ONNX Runtime says, in one line, without the number of its error, the path and the place in its source."""
    text = " ".join(str(error).split())
    for part in (
        r"^\[ONNXRuntimeError\] : \d+ : \w+ : ",
        r"^Load model from .*? failed: ?",
        r"/\S*onnxruntime\S*:\d+ .*?\) ",
    ):
        text = re.sub(part, "", text)
    return text


def model_error(model: str, problem: str, limit: object, remedy: str) -> ConfigError:
    """The error about a network: "onnx_model = PATH" and the problem."""
    return ConfigError(
        f"onnx_model = {model!r} {problem}", value=model, limit=limit, remedy=remedy, settings=("onnx_model",)
    )
