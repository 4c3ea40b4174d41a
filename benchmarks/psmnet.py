# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""PSMNet in PyTorch, for its export to ONNX by export_psmnet.py.

Written from the paper (Chang and Chen, "Pyramid Stereo Matching Network", CVPR 2018, table 1); only the names of its
parts are those of the published weights, so that these load. Two things are as the weights need them (on a part of
Middlebury's Venus, errors above 1 px and median signed error): dilations 1 and 2 in the last two stages (9.5 %,
+0.44 px), where the table has 2 and 4 (14.9 %, +0.71 px), and align_corners where values are interpolated; without it
disparities are 1.7 px too large.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

__all__ = ["DISPARITIES", "PSMNet"]

DISPARITIES = 192


def plain_conv(inputs: int, outputs: int, size: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """A convolution of images and its batch normalization."""
    padding = dilation if size > 1 else 0
    conv = nn.Conv2d(inputs, outputs, size, stride, padding, dilation, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outputs))


def volume_conv(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """A convolution of volumes and its batch normalization."""
    return nn.Sequential(nn.Conv3d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm3d(outputs))


def double_size(inputs: int, outputs: int) -> nn.Sequential:
    """A transposed convolution of volumes to twice the size, and its batch normalization."""
    conv = nn.ConvTranspose3d(inputs, outputs, 3, stride=2, padding=1, output_padding=1, bias=False)
    return nn.Sequential(conv, nn.BatchNorm3d(outputs))


class Residual(nn.Module):  # type: ignore[misc]
    """Two convolutions whose result is added to their input."""

    def __init__(self, inputs: int, outputs: int, stride: int, dilation: int) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(plain_conv(inputs, outputs, 3, stride, dilation), nn.ReLU())
        self.conv2 = plain_conv(outputs, outputs, 3, 1, dilation)
        changes = stride != 1 or inputs != outputs
        self.downsample = plain_conv(inputs, outputs, 1, stride) if changes else nn.Identity()

    def forward(self, x: Tensor) -> Tensor:
        added: Tensor = self.downsample(x) + self.conv2(self.conv1(x))
        return added


def residuals(inputs: int, outputs: int, count: int, stride: int = 1, dilation: int = 1) -> nn.Sequential:
    """A stage of residual blocks; the first one changes channels and size."""
    first = Residual(inputs, outputs, stride, dilation)
    return nn.Sequential(first, *(Residual(outputs, outputs, 1, dilation) for _ in range(count - 1)))


class Features(nn.Module):  # type: ignore[misc]
    """Features at a quarter of the size: (B, 32, H / 4, W / 4), with spatial pyramid pooling."""

    def __init__(self) -> None:
        super().__init__()
        convs = [plain_conv(3, 32, 3, 2), plain_conv(32, 32, 3), plain_conv(32, 32, 3)]
        self.firstconv = nn.Sequential(*(layer for conv in convs for layer in (conv, nn.ReLU())))
        self.layer1 = residuals(32, 32, 3)
        self.layer2 = residuals(32, 64, 16, stride=2)
        self.layer3 = residuals(64, 128, 3)
        self.layer4 = residuals(128, 128, 3, dilation=2)
        for number, size in enumerate((64, 32, 16, 8), 1):
            branch = nn.Sequential(nn.AvgPool2d(size, size), plain_conv(128, 32, 1), nn.ReLU())
            self.add_module(f"branch{number}", branch)
        fusion = plain_conv(320, 128, 3)
        self.lastconv = nn.Sequential(fusion, nn.ReLU(), nn.Conv2d(128, 32, 1, bias=False))

    def forward(self, image: Tensor) -> Tensor:
        middle = self.layer2(self.layer1(self.firstconv(image)))
        deep = self.layer4(self.layer3(middle))
        pooled = [
            functional.interpolate(
                self.get_submodule(f"branch{number}")(deep), deep.shape[2:], mode="bilinear", align_corners=True
            )
            for number in (4, 3, 2, 1)
        ]
        fused: Tensor = self.lastconv(torch.cat([middle, deep, *pooled], 1))
        return fused


class Hourglass(nn.Module):  # type: ignore[misc]
    """An encoder and decoder of the cost volume, with the features of the one before it."""

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(volume_conv(32, 64, 2), nn.ReLU())
        self.conv2 = volume_conv(64, 64)
        self.conv3 = nn.Sequential(volume_conv(64, 64, 2), nn.ReLU())
        self.conv4 = nn.Sequential(volume_conv(64, 64), nn.ReLU())
        self.conv5 = double_size(64, 64)
        self.conv6 = double_size(64, 32)

    def forward(self, volume: Tensor, encoded: Tensor | None, decoded: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
        """The volume, and this one's halves of both ways; ``encoded`` and ``decoded`` are those before."""
        half = self.conv2(self.conv1(volume))
        half = functional.relu(half if decoded is None else half + decoded)
        quarter = self.conv4(self.conv3(half))
        back = functional.relu(self.conv5(quarter) + (half if encoded is None else encoded))
        return self.conv6(back), half, back


class PSMNet(nn.Module):  # type: ignore[misc]
    """Left and right image (1, 3, H, W), normalized, to the disparity (1, 1, H, W), px of the input."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_extraction = Features()
        self.dres0 = nn.Sequential(volume_conv(64, 32), nn.ReLU(), volume_conv(32, 32), nn.ReLU())
        self.dres1 = nn.Sequential(volume_conv(32, 32), nn.ReLU(), volume_conv(32, 32))
        self.dres2, self.dres3, self.dres4 = Hourglass(), Hourglass(), Hourglass()
        self.classif1, self.classif2, self.classif3 = (
            nn.Sequential(volume_conv(32, 32), nn.ReLU(), nn.Conv3d(32, 1, 3, padding=1, bias=False)) for _ in range(3)
        )

    def forward(self, left: Tensor, right: Tensor) -> Tensor:
        volume = concatenated(self.feature_extraction(left), self.feature_extraction(right))
        volume = self.dres0(volume)
        volume = volume + self.dres1(volume)
        first, half, back = self.dres2(volume, None, None)
        first = first + volume
        second, _, back = self.dres3(first, half, back)
        second = second + volume
        third, _, _ = self.dres4(second, half, back)
        third = third + volume
        cost = self.classif3(third) + self.classif2(second) + self.classif1(first)
        size = [DISPARITIES, left.shape[2], left.shape[3]]
        whole = functional.interpolate(cost, size, mode="trilinear", align_corners=True)
        share = torch.softmax(whole[:, 0], 1)
        disparities = torch.arange(DISPARITIES, dtype=share.dtype).reshape(1, -1, 1, 1)
        return (share * disparities).sum(1, keepdim=True)


def concatenated(left: Tensor, right: Tensor) -> Tensor:
    """(B, 2 C, D, H, W): the features of the left pixels and of the right ones at each disparity, 0 outside."""
    planes = []
    for shift in range(DISPARITIES // 4):
        ours = functional.pad(left[..., shift:], (shift, 0))
        theirs = functional.pad(right[..., : right.shape[3] - shift], (shift, 0))
        planes.append(torch.cat([ours, theirs], 1))
    return torch.stack(planes, 2)
