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
import pickle
import queue
import resource
import secrets
import subprocess
import sys
import threading
import time
import traceback
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["main"]

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 10.0  # of a case
MOST_MIB = 1024  # of a case, beyond what the process had before
ADDRESSES = 16 << 30  # of a worker, so that no case takes the machine
START_S = 120.0  # of a worker, which may compile kernels
CHUNK = 200  # cases of one seed


@dataclass
class Tally:
    """What became of the cases of one target."""

    cases: int = 0
    tracebacks: int = 0
    hangs: int = 0
    large: int = 0
    peak_mib: float = 0.0
    places: set[str] = field(default_factory=set)


def main() -> int:
    """Run the targets, or one input again; 1 where a case failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="how long, all targets together")
    parser.add_argument("--targets", nargs="*", metavar="NAME", help="targets by name; all by default")
    parser.add_argument("--output", type=Path, default=Path("fuzz"), metavar="FOLDER", help="keeps failing inputs")
    parser.add_argument("--input", type=Path, metavar="FILE", help="run this input again")
    parser.add_argument("--seed", type=int, help="of all cases; a fresh one by default")
    parser.add_argument("--worker", nargs=2, metavar=("NAME", "FILE"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        name, current = options.worker
        return work(name, current, options.seed)
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
    current = output / "current.pickle"
    command = [sys.executable, str(Path(__file__).resolve()), "--worker", name, str(current), "--seed", str(seed)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    lines: queue.Queue[str] = queue.Queue()
    assert process.stdout is not None
    stream = process.stdout

    def read() -> None:
        for line in stream:
            lines.put(line)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    end, begun = time.monotonic() + seconds, False
    try:
        while time.monotonic() < end or not begun:
            try:
                line = lines.get(timeout=LONGEST_S if begun else START_S)
            except queue.Empty:
                stopped = process.poll() is not None
                tally.hangs += not stopped
                tally.tracebacks += stopped
                keep(output, tally, name, None, "the process ended" if stopped else f"more than {LONGEST_S:g} s")
                return
            begun = True
            note(line.rstrip("\n").split("\t"), output, tally, name)
            if process.poll() is not None and lines.empty():
                tally.tracebacks += 1
                keep(output, tally, name, None, f"the process ended with code {process.returncode}")
                return
    finally:
        process.kill()
        process.wait()
        reader.join()
        current.unlink(missing_ok=True)


def note(words: list[str], output: Path, tally: Tally, name: str) -> None:
    """A line of a worker: memory of the case, MiB, and the place where it failed, with its traceback escaped."""
    if words[0] == "ready":
        return
    tally.cases += 1
    used_mib = float(words[0])
    tally.peak_mib = max(tally.peak_mib, used_mib)
    if used_mib > MOST_MIB:
        tally.large += 1
        keep(output, tally, name, words[1] or None, f"{used_mib:.0f} MiB")
    if words[1]:
        tally.tracebacks += 1
        keep(output, tally, name, words[1], words[2].encode().decode("unicode_escape"))


def keep(output: Path, tally: Tally, name: str, place: str | None, why: str) -> None:
    """The current case as a file, unless there is one of its place already."""
    if (place or why) in tally.places:
        return
    tally.places.add(place or why)
    stem = output / f"{name.replace(' ', '_')}_{len(tally.places)}"
    current = output / "current.pickle"
    failed = output / "failed.pickle"
    source = failed if place and failed.exists() else current
    if source.exists():
        stem.with_suffix(".pickle").write_bytes(source.read_bytes())
    stem.with_suffix(".txt").write_text(f"{name}: {place or ''}\n{why}\n", encoding="utf-8", errors="replace")


def work(name: str, current: str, seed: int) -> int:
    """Run cases and write a line for each to the standard output that this process had when it began."""
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as seeded

    resource.setrlimit(resource.RLIMIT_AS, (ADDRESSES, ADDRESSES))
    lines = sys.stdout
    sys.stdout = sys.stderr
    module, target = targets(), target_of(name)
    path = Path(current)
    failures: set[str] = set()
    warnings.simplefilter("error", RuntimeWarning)

    def run(case: Any) -> None:
        path.write_bytes(pickle.dumps((name, case)))
        before_mib = reset_peak()
        place = why = ""
        try:
            module.run_case(target, case)
        except Exception as error:
            place, why = place_of(error), traceback.format_exc()
            if place not in failures:
                failures.add(place)
                path.with_name("failed.pickle").write_bytes(path.read_bytes())
        escaped = why.encode("unicode_escape").decode()
        print(f"{peak_mib() - before_mib:.1f}\t{place}\t{escaped}", file=lines, flush=True)

    print("ready", file=lines, flush=True)
    number = 0
    for case in target.known:
        run(case)
    while True:
        chunk = settings(
            max_examples=CHUNK,
            database=None,
            deadline=None,
            phases=(Phase.generate,),
            suppress_health_check=list(HealthCheck),
        )
        test: Any = given(target.cases)(run)
        cases: Any = seeded(1000 * seed + number)
        cases(chunk(test))()
        number += 1


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
