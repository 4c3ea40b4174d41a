# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Fuzzing with fresh seeds: the targets of test/fuzz_targets.py, each in a process that is watched.

    python benchmarks/fuzz.py --minutes 10

Prints for each target the cases, those that ended with a traceback or with the process, those above 10 s, and those
above the limit of memory. The inputs of these are kept in a folder, one for each place in the code, beside their
traceback; `--input FILE` runs one of them again. The exit code is 1 if there are any.
"""

from __future__ import annotations

import argparse
import importlib
import itertools
import os
import pickle
import queue
import re
import resource
import secrets
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["main"]

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 10.0  # of a case
MOST_MIB = 1024  # of a case, beyond what the process had before
ADDRESSES = 16 << 30  # of a worker, so that no case takes the machine
START_S = 120.0  # of a worker, which may compile kernels
CHUNK = 200  # cases of one seed
CURRENT = "current.pickle"  # the case that a worker runs


@dataclass
class Tally:
    """What became of the cases of one target."""

    cases: int = 0
    tracebacks: int = 0
    hangs: int = 0
    large: int = 0
    peak_mib: float = 0.0

    def note(self, words: list[str]) -> None:
        """A line of a worker: the memory of the case, MiB, and whether it failed."""
        used_mib = float(words[0])
        self.cases += 1
        self.tracebacks += int(words[1])
        self.large += used_mib > MOST_MIB
        self.peak_mib = max(self.peak_mib, used_mib)


def main() -> int:
    """Run the targets, or one input again; 1 where a case failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="how long, all targets together")
    parser.add_argument("--targets", nargs="*", metavar="NAME", help="targets by name; all by default")
    parser.add_argument("--output", type=Path, default=Path("fuzz"), metavar="FOLDER", help="keeps failing inputs")
    parser.add_argument("--input", type=Path, metavar="FILE", help="run this input again")
    parser.add_argument("--seed", type=int, help="of all cases; a fresh one by default")
    parser.add_argument("--worker", metavar="NAME", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        return work(options.worker, options.output, options.seed)
    if options.input:
        name, case = pickle.loads(options.input.read_bytes())
        targets().run_case(target_of(name), case)
        return 0
    seed = secrets.randbits(32) if options.seed is None else options.seed
    names = options.targets or [target.name for target in targets().TARGETS]
    print(f"seed {seed}, {options.minutes:g} minutes, failing inputs in {options.output}", flush=True)
    tallies = {}
    for number, name in enumerate(names):
        tallies[name] = examine(name, 60 * options.minutes / len(names), seed + number, options.output)
        print(f"{name}: {tallies[name].cases} cases", file=sys.stderr, flush=True)
    print(table(tallies))
    return int(any(tally.tracebacks or tally.hangs or tally.large for tally in tallies.values()))


def targets() -> Any:
    """The module of the targets, which is part of the tests."""
    if str(ROOT / "test") not in sys.path:
        sys.path[:0] = [str(ROOT / "test"), str(ROOT)]
    return importlib.import_module("fuzz_targets")


def target_of(name: str) -> Any:
    """The target of that name."""
    return next(target for target in targets().TARGETS if target.name == name)


def table(tallies: dict[str, Tally]) -> str:
    """A row for each target, and their sum."""
    head = ("target", "cases", "tracebacks", f"above {LONGEST_S:g} s", f"above {MOST_MIB} MiB", "peak MiB")
    rows: list[tuple[str, ...]] = [
        (name, str(t.cases), str(t.tracebacks), str(t.hangs), str(t.large), f"{t.peak_mib:.0f}")
        for name, t in tallies.items()
    ]
    sums = [sum(int(row[at]) for row in rows) for at in range(1, 5)]
    rows.append(("all", *map(str, sums), f"{max((t.peak_mib for t in tallies.values()), default=0):.0f}"))
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ("---",) * len(head), *rows))


def examine(name: str, seconds: float, seed: int, output: Path) -> Tally:
    """Run cases of a target for a time, in one process after another where a case ends or stops it."""
    tally, end = Tally(), time.monotonic() + seconds
    while (left_s := end - time.monotonic()) > 0:
        run_worker(name, left_s, seed, output, tally)
        seed += 1_000_003
    return tally


def run_worker(name: str, seconds: float, seed: int, output: Path, tally: Tally) -> None:
    """One process, until the time is over, it ends, or a case takes too long."""
    output.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(Path(__file__).resolve()), "--worker", name, "--seed", str(seed)]
    scratch = tempfile.TemporaryDirectory()  # of a process that is killed, which removes nothing
    process = subprocess.Popen(
        [*command, "--output", str(output)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "TMPDIR": scratch.name},
    )
    lines: queue.Queue[str] = queue.Queue()
    assert process.stdout is not None
    stream = process.stdout

    def read() -> None:
        for line in stream:
            lines.put(line)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    end, begun = time.monotonic() + seconds, False
    current = output / CURRENT
    try:
        while time.monotonic() < end or not begun:
            try:
                words = lines.get(timeout=LONGEST_S if begun else START_S).split()
            except queue.Empty:
                words = ["stopped"]
            if words[0] == "stopped":
                stopped = process.poll() is not None
                tally.cases += 1
                tally.hangs += not stopped
                tally.tracebacks += stopped
                why = f"the process ended with code {process.returncode}" if stopped else f"more than {LONGEST_S:g} s"
                keep(output, name, why, why, current.read_bytes() if current.exists() else b"")
                return
            if begun:
                tally.note(words)
            begun = True
    finally:
        process.kill()
        process.wait()
        reader.join()
        current.unlink(missing_ok=True)
        scratch.cleanup()


def keep(output: Path, name: str, place: str, why: str, case: bytes) -> None:
    """A failing case as a file, and why it fails in another; the first one of its place only."""
    stem = re.sub(r"\W+", "_", f"{name} {place}")
    if not (path := output / f"{stem}.pickle").exists():
        path.write_bytes(case)
        path.with_suffix(".txt").write_text(f"{name}: {place}\n{why}\n", encoding="utf-8", errors="replace")


def work(name: str, output: Path, seed: int) -> int:
    """Run cases, and write a line for each to the standard output that this process had when it began."""
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as seeded

    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    lines = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # a command writes to its own standard output
    module, target = targets(), target_of(name)
    chunk = settings(
        max_examples=CHUNK,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )

    def run(case: Any) -> None:
        data = pickle.dumps((name, case))
        (output / CURRENT).write_bytes(data)
        before_mib, failed = reset_peak(), False
        try:
            module.run_case(target, case)
        except Exception as error:
            failed = True
            keep(output, name, place_of(error), traceback.format_exc(), data)
        used_mib = peak_mib() - before_mib
        if used_mib > MOST_MIB:
            keep(output, name, f"above {MOST_MIB} MiB", f"{used_mib:.0f} MiB", data)
        lines.write(f"{used_mib:.1f} {int(failed)}\n")

    lines.write("ready\n")
    for case in target.known:
        run(case)
    for number in itertools.count():
        fresh: Any = seeded(1000 * seed + number)
        fresh(chunk(given(target.cases)(run)))()  # type: ignore[no-untyped-call]
    return 0


def place_of(error: BaseException) -> str:
    """Class of the error, file and line of the last frame inside the package."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "stereo_depth_ros/" in frame.filename] or frames
    return f"{type(error).__name__} at {Path(own[-1].filename).name}:{own[-1].lineno}"


def reset_peak() -> float:
    """Memory of this process now, MiB; its peak counts from here."""
    Path("/proc/self/clear_refs").write_text("5")
    return status_mib("VmRSS")


def peak_mib() -> float:
    """Largest memory of this process since :func:`reset_peak`, MiB."""
    return status_mib("VmHWM")


def status_mib(key: str) -> float:
    """A value in kB of /proc/self/status in MiB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(f"{key}:")).split()[1]) / 1024


if __name__ == "__main__":
    raise SystemExit(main())
