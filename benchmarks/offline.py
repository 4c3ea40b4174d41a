# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Offline processing: pairs a second and CPU time of `stereo-depth process` against rectifying and matching alone.

python benchmarks/offline.py bags/synthetic_room.mcap kitti.mcap
python benchmarks/offline.py --synthetic 20  # pairs of 1280x720

The bare loop has the decoded images in memory. Both process the same pairs in turns in one run, with all cores.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from stereo_depth_ros.bags.pairs import BagSelection
from stereo_depth_ros.config import PipelineConfig
from stereo_depth_ros.config.output_topics import DEFAULT_OUTPUTS
from stereo_depth_ros.offline.engine import process_bag
from stereo_depth_ros.offline.pairs import read_pairs
from stereo_depth_ros.pipeline import StereoPipeline
from stereo_depth_ros.synthetic.bag import write_synthetic_bag
from stereo_depth_ros.synthetic.sequence import SyntheticSequence

SIZE = 1280, 720
RUNS = {
    "disparity, depth": ("disparity", "depth"),
    ", ".join(DEFAULT_OUTPUTS): DEFAULT_OUTPUTS,
    "all": ("all",),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="*", type=Path, help="stereo bags")
    parser.add_argument("--synthetic", type=int, default=0, metavar="N", help="so many rendered pairs of 1280x720 too")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="runs in turns, of which the median counts")
    parser.add_argument("--compression", default="lz4", help="none, lz4 or zstd")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        bags = [*arguments.bags]
        if arguments.synthetic:
            bags.append(Path(folder) / "synthetic.mcap")
            write_synthetic_bag(bags[-1], SyntheticSequence(arguments.synthetic, *SIZE))
        print(f"{'bag':20} {'outputs':24} {'pairs/s':>8} {'ratio':>6} {'CPU ms':>7} {'ratio':>6}")
        for bag in bags:
            for name, rate, cpu_s, bare_rate, bare_cpu_s in measured(
                bag, Path(folder) / "out.mcap", arguments.rounds, arguments.compression
            ):
                ratios = rate / bare_rate, cpu_s / bare_cpu_s
                numbers = f"{rate:8.2f} {ratios[0]:6.2f} {1e3 * cpu_s:7.1f} {ratios[1]:6.2f}"
                print(f"{bag.stem:20} {name:24} {numbers}", flush=True)
    print(
        f"most memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB, the images of a bag included"
    )


def measured(
    bag: Path, output: Path, rounds: int, compression: str
) -> Iterator[tuple[str, float, float, float, float]]:
    """Name, pairs a second, CPU seconds a pair, and both of the bare loop: medians of the ratios' terms."""
    config = PipelineConfig()
    images = [*read_pairs(bag)]
    pipeline = StereoPipeline(config, images[0][1])

    def bare() -> None:
        for pair, _ in images:
            pipeline.process(pair)

    def offline(outputs: tuple[str, ...]) -> Callable[[], object]:
        return lambda: process_bag(
            BagSelection(bag), output, config, outputs=outputs, compression=compression, overwrite=True
        )

    calls = {"": bare, **{name: offline(outputs) for name, outputs in RUNS.items()}}
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    bare()  # kernels
    for _ in range(rounds):
        for name, call in calls.items():
            start = time.perf_counter(), time.process_time()
            call()
            found[name].append((time.perf_counter() - start[0], time.process_time() - start[1]))
    medians = {name: [statistics.median(each) for each in zip(*times, strict=True)] for name, times in found.items()}
    for name in RUNS:
        (wall_s, cpu_s), (bare_wall_s, bare_cpu_s) = medians[name], medians[""]
        count = len(images)
        yield name, count / wall_s, cpu_s / count, count / bare_wall_s, bare_cpu_s / count


if __name__ == "__main__":
    main()
