# SPDX-FileCopyrightText: The stereo_depth_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Faults in random order while the nodes run: every output must be, byte for byte, the offline result of its pair.

Faults: kill -9 of nodes and of the camera, which comes back with another QoS; another size, encoding or calibration in
flight; a clock that goes back; random parameters under load; a second camera on the same topics; a stopped reliable
subscriber of points2. An output is right if it is the result of the pair of its stamp with parameters that were set at
some time between the publishing of the pair and the arrival of the output. Two cameras at once have one clock and never
the same stamp: with two clocks, each camera would set the clock of the other back. After each fault, an output of every
topic from a later pair must arrive. The exit code is 1 if an output is wrong or does not come, or a node ends by itself
or logs a traceback.

    python benchmarks/fault_injection.py
    python benchmarks/fault_injection.py --shapes separate --seconds 300 --seed 5
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from faulty_camera import FRAMES, SOURCES, infos_of, key_of, pair_of

from stereo_depth_ros.bags.message_types import RosbagsTypes
from stereo_depth_ros.config import (
    MatchingConfig,
    PipelineConfig,
    parameter_infos,
    replace_checked,
)
from stereo_depth_ros.core.errors import ConfigError
from stereo_depth_ros.core.rig import StereoRig
from stereo_depth_ros.core.types import StereoPair
from stereo_depth_ros.messages.image import decode_pair
from stereo_depth_ros.nodes.transport import prepare_process
from stereo_depth_ros.outputs import OUTPUTS, ResultMessages
from stereo_depth_ros.pipeline import StereoPipeline, StereoResult
from stereo_depth_ros.replay.graph_processes import SHAPES

os.environ.setdefault("ROS_DOMAIN_ID", "94")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
prepare_process()

import rclpy  # noqa: E402
from rcl_interfaces.srv import SetParameters  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import QoSProfile  # noqa: E402
from stopped_subscriber import subscriber  # noqa: E402

from stereo_depth_ros.nodes.message_types import message_class  # noqa: E402

__all__ = ["FRAMES", "History", "Table", "main"]

TOPICS = ("points2", "disparity", "depth/image_rect")
BUILDERS = {row.topic: row for row in OUTPUTS if row.topic in TOPICS}
RECOVERY_S = 60.0
BASE = PipelineConfig(matching=replace_checked(MatchingConfig(), {"stereo_algorithm": 0, "disparity_range": 32}))
# Of each config: the separate node that has it, and the values that are tried
CHANGES: dict[str, tuple[str, dict[str, tuple[Any, ...]]]] = {
    "matching": (
        "disparity_node",
        {
            "stereo_algorithm": (0, 1, 2),
            "disparity_range": (32, 48, 64),
            "min_disparity": (-8, 0, 4),
            "uniqueness_ratio": (0.0, 5.0, 15.0),
            "correlation_window_size": (7, 11, 15),
            "speckle_size": (0, 50, 100),
            "disparity_filter": ("none", "mean", "median"),
            "sgm_paths": (0, 4, 8),
            "quality": ("fast", "default", "best"),
        },
    ),
    "cloud": ("point_cloud_node", {"use_color": (False, True), "avoid_point_cloud_padding": (False, True)}),
    "depth": ("depth_node", {"depth_encoding": ("32FC1", "16UC1")}),
}


class Setting(NamedTuple):
    """A value, and when it may have been in use, seconds of the monotonic clock."""

    value: Any
    since: float
    until: float


class History:
    """The values of one config over time: a new one may be in use from its request on, an old one until the answer."""

    def __init__(self, value: Any) -> None:
        self._settings = [Setting(value, 0.0, np.inf)]

    @property
    def current(self) -> Any:
        """The newest value."""
        return self._settings[-1].value

    def change(self, value: Any, requested: float, answered: float) -> None:
        """Note a change."""
        self._settings[-1] = self._settings[-1]._replace(until=answered)
        self._settings.append(Setting(value, requested, np.inf))

    def between(self, since: float, until: float) -> list[Any]:
        """The values that may have been in use at some time in between, the newest first."""
        return [s.value for s in reversed(self._settings) if s.since <= until and s.until >= since]


@dataclass
class Table:
    """Counts by kind of fault."""

    rows: dict[str, collections.Counter[str]] = field(default_factory=dict)
    recoveries_s: dict[str, list[float]] = field(default_factory=lambda: collections.defaultdict(list))
    COLUMNS = ("trials", "compared", "wrong", "not recovered", "crashes")

    def add(self, fault: str, column: str, count: int = 1) -> None:
        """Count."""
        self.rows.setdefault(fault, collections.Counter())[column] += count

    @property
    def failed(self) -> bool:
        """Whether anything is wrong."""
        return any(row[column] for row in self.rows.values() for column in self.COLUMNS[2:])

    def __str__(self) -> str:
        total = sum(self.rows.values(), collections.Counter())
        lines = [f"{'fault':>20} " + " ".join(f"{name:>13}" for name in (*self.COLUMNS, "recovery s"))]
        for fault, row in {**self.rows, "all": total}.items():
            times = self.recoveries_s.get(fault) or [np.nan]
            counts = " ".join(f"{row[name]:13d}" for name in self.COLUMNS)
            lines.append(f"{fault:>20} {counts} {np.median(times):13.1f}")
        return "\n".join(lines)


class Offline:
    """The offline results, cached; with the stamps of the messages that they are compared with."""

    def __init__(self) -> None:
        self._types = RosbagsTypes()
        self._messages = ResultMessages(self._types)
        self._results: dict[Any, StereoResult] = {}

    def message(self, topic: str, stamp_ns: int, config: PipelineConfig) -> bytes:
        """The serialized output of the pair of this stamp."""
        result = self._result(stamp_ns, config)
        left, right = (dataclasses.replace(f, stamp_ns=stamp_ns) for f in (result.pair.left, result.pair.right))
        stamped = dataclasses.replace(result, pair=StereoPair(left, right), config=config)
        return self._types.serialize(BUILDERS[topic].build(self._messages, stamped))

    def _result(self, stamp_ns: int, config: PipelineConfig) -> StereoResult:
        source, frame = key_of(stamp_ns)
        key = source, frame, config.matching
        if key not in self._results:
            rig = StereoRig.from_infos(*infos_of(source, stamp_ns))
            pair = decode_pair(*pair_of(source, frame, stamp_ns), ("left", "right"))
            self._results[key] = StereoPipeline(config, rig).process(pair)
        return self._results[key]


class CameraProcess:
    """A camera in a process of its own, and what it has sent."""

    def __init__(self, source: int, sent_at: dict[int, float], *arguments: str) -> None:
        program = Path(__file__).with_name("faulty_camera.py")
        self.process = subprocess.Popen(
            [sys.executable, str(program), "--source", str(source), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._sent_at = sent_at
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if len(words := line.split()) == 2:
                self._sent_at.setdefault(int(words[0]), int(words[1]) / 1e9)

    def tell(self, command: str) -> None:
        """A line of its standard input."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{command}\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        """With SIGKILL."""
        self.process.kill()
        self.process.wait()


class Nodes:
    """The nodes of a shape as processes, and the parameters that they have."""

    def __init__(self, shape: str, folder: Path) -> None:
        self.fused = shape == "fused"
        self.histories = {
            "matching": History(BASE.matching),
            "cloud": History(BASE.cloud),
            "depth": History(BASE.depth),
        }
        self._folder = folder
        self._starts = itertools.count()
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in SHAPES[shape]:
            self.start(name)

    @property
    def names(self) -> list[str]:
        """Names of the nodes."""
        return list(self._processes)

    def owner(self, group: str) -> str:
        """The node that has a config."""
        return "stereo_depth_node" if self.fused else CHANGES[group][0]

    def start(self, name: str) -> None:
        """Start a node with the parameters of now."""
        arguments = ["--ros-args"]
        for group, (_, values) in CHANGES.items():
            if self.owner(group) == name:
                config = self.histories[group].current
                fields = {info.name: info.field for info in parameter_infos(type(config))}
                for key in values:
                    arguments += ["-p", f"{key}:={json.dumps(getattr(config, fields[key]))}"]
        with (self._folder / f"{next(self._starts):04d}_{name}.log").open("wb") as log:
            command = [sys.executable, "-m", f"stereo_depth_ros.nodes.{name}", *arguments]
            self._processes[name] = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)

    def kill(self, name: str) -> None:
        """With SIGKILL."""
        self._processes[name].kill()
        self._processes[name].wait()

    def crashes(self) -> int:
        """Nodes that have ended by themselves, which are started again, and new tracebacks in the logs."""
        ended = [name for name, process in self._processes.items() if process.poll() is not None]
        for name in ended:
            print(f"{name} has ended with {self._processes[name].returncode}", flush=True)
            self.start(name)
        count = len(ended)
        for log in sorted(self._folder.glob("*.log")):
            text = log.read_text(errors="replace")
            if "Traceback" in text or "unexpected" in text:
                print(f"{log.name}: {text[-3000:]}", flush=True)
                count += 1
                log.rename(log.with_suffix(".reported"))
        return count

    def stop(self) -> None:
        """End all of them."""
        for process in self._processes.values():
            process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


class FaultInjection:
    """Nodes, cameras and a subscriber that compares; each fault is a method."""

    def __init__(self, nodes: Nodes, table: Table, random_: random.Random) -> None:
        self._nodes, self._table, self._random = nodes, table, random_
        self._offline = Offline()
        self._node = rclpy.create_node("fault_injection")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._sent_at: dict[int, float] = {}
        self._newest = dict.fromkeys(TOPICS, 0.0)  # publishing time of the newest pair with a right output
        self._fault = "start"
        for topic in TOPICS:
            kind = message_class(BUILDERS[topic].msgtype)
            self._node.create_subscription(kind, topic, self._receiver(topic), QoSProfile(depth=50), raw=True)
        self._source = 0
        self._camera = CameraProcess(0, self._sent_at)
        self._clock_s = 0.0

    def run(self, fault: str) -> None:
        """One trial."""
        self._fault = fault
        self._table.add(fault, "trials")
        FAULTS[fault](self)
        over = time.monotonic()
        if self._spin(lambda: min(self._newest.values()) > over, RECOVERY_S):
            self._table.recoveries_s[fault].append(time.monotonic() - over)
        else:
            late = [topic for topic, sent in self._newest.items() if sent <= over]
            print(f"{fault}: no {', '.join(late)} within {RECOVERY_S:g} s", flush=True)
            self._table.add(fault, "not recovered")
        if count := self._nodes.crashes():
            self._table.add(fault, "crashes", count)
        if self._camera.process.poll() is not None:
            raise RuntimeError(f"the camera has ended with {self._camera.process.returncode}")

    def close(self) -> None:
        """End the camera and the subscriber."""
        self._camera.kill()
        self._executor.shutdown()
        self._node.destroy_node()

    def start(self) -> None:
        """No fault: the nodes come up."""

    def kill_nodes(self) -> None:
        """Some nodes at once, in any order; they start again in any order."""
        names = self._random.sample(self._nodes.names, self._random.randint(1, len(self._nodes.names)))
        for name in names:
            self._nodes.kill(name)
            self._wait(self._random.choice((0.0, 0.0, 1.0)))
        for name in self._random.sample(names, len(names)):
            self._nodes.start(name)

    def kill_camera(self) -> None:
        """It comes back with another QoS and what it sent before."""
        self._camera.kill()
        self._wait(self._random.choice((0.0, 0.5, 2.0)))
        self._camera = CameraProcess(self._source, self._sent_at, *self._qos())
        self._clock_s = 0.0

    def change_source(self) -> None:
        """Other images of another camera in flight, several times."""
        for _ in range(self._random.randint(1, 4)):
            self._source = self._random.randrange(len(SOURCES))
            self._camera.tell(f"source {self._source}")
            self._wait(self._random.uniform(0.0, 1.0))

    def set_clock_back(self) -> None:
        """By less and by more than the pairing takes for jitter."""
        for _ in range(self._random.randint(1, 3)):
            step_s = -self._random.choice((0.05, 0.5, 2.0, 100.0))
            self._camera.tell(f"clock {step_s}")
            self._clock_s += step_s
            self._wait(self._random.uniform(0.0, 0.5))

    def set_parameters(self) -> None:
        """Random ones, at six times the rate."""
        self._camera.tell("rate 60")
        for _ in range(self._random.randint(2, 8)):
            self._set_parameter()
            self._wait(self._random.uniform(0.0, 0.3))
        self._camera.tell("rate 10")

    def add_camera(self) -> None:
        """A second camera on the same topics, with another source and QoS, for a few seconds."""
        clock = ("--clock", str(self._clock_s))
        other = CameraProcess(self._random.randrange(len(SOURCES)), self._sent_at, *self._qos(), *clock)
        try:
            self._wait(self._random.uniform(2.0, 6.0))
        finally:
            other.kill()

    def stop_subscriber(self) -> None:
        """A reliable subscriber of points2 that is stopped for a few seconds."""
        with subscriber() as process:
            self._spin(lambda: self._node.count_subscribers("points2") > 1, 10.0)
            self._wait(1.0)
            process.send_signal(signal.SIGSTOP)
            since = time.monotonic()
            if not self._spin(lambda: self._newest["points2"] > since + 2.0, RECOVERY_S):
                print("no points2 while another subscriber is stopped", flush=True)
                self._table.add(self._fault, "not recovered")

    def _qos(self) -> list[str]:
        flags = [flag for flag in ("--best-effort", "--latched") if self._random.random() < 0.5]
        return [*flags, "--depth", str(self._random.choice((1, 5, 50)))]

    def _set_parameter(self) -> None:
        group = self._random.choice(("matching", "matching", "cloud", "depth"))
        name = self._random.choice(list(CHANGES[group][1]))
        value = self._random.choice(CHANGES[group][1][name])
        history = self._nodes.histories[group]
        try:
            changed = replace_checked(history.current, {name: value})
        except ConfigError:
            return
        client = self._node.create_client(SetParameters, f"/{self._nodes.owner(group)}/set_parameters")
        self._spin(client.service_is_ready, RECOVERY_S)
        requested = time.monotonic()
        future = client.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))
        self._spin(future.done, RECOVERY_S)
        answer = future.result() if future.done() else None
        self._node.destroy_client(client)
        if answer is None or not answer.results[0].successful:
            raise RuntimeError(f"{name} = {value} was not set: {answer}")
        history.change(changed, requested, time.monotonic())

    def _receiver(self, topic: str) -> Callable[[bytes], None]:
        return lambda data: self._compare(topic, data)

    def _compare(self, topic: str, data: bytes) -> None:
        now = time.monotonic()
        seconds, nanoseconds = np.frombuffer(data, "<u4", 2, 4).tolist()
        stamp_ns = seconds * 10**9 + nanoseconds
        self._table.add(self._fault, "compared")
        sent_at = self._sent_at.get(stamp_ns)
        if sent_at is None:
            time.sleep(0.1)  # for the thread that reads
            sent_at = self._sent_at.get(stamp_ns)
        if sent_at is not None and self._is_right(topic, stamp_ns, data, sent_at, now):
            self._newest[topic] = max(self._newest[topic], sent_at)
            return
        self._table.add(self._fault, "wrong")
        print(f"wrong: {topic} of {stamp_ns} {key_of(stamp_ns)} at {self._fault}, sent at {sent_at}", flush=True)

    def _is_right(self, topic: str, stamp_ns: int, data: bytes, sent_at: float, now: float) -> bool:
        histories = [self._nodes.histories[group].between(sent_at, now) for group in ("matching", "depth", "cloud")]
        return any(
            self._offline.message(topic, stamp_ns, PipelineConfig(BASE.pairing, *configs)) == data
            for configs in itertools.product(*histories)
        )

    def _wait(self, seconds: float) -> None:
        self._spin(lambda: False, seconds)

    def _spin(self, condition: Callable[[], object], timeout_s: float) -> bool:
        end = time.monotonic() + timeout_s
        while not condition():
            if (left := end - time.monotonic()) <= 0:
                return False
            self._executor.spin_once(timeout_sec=min(0.05, left))
        return True


FAULTS: dict[str, Callable[[FaultInjection], None]] = {
    "start": FaultInjection.start,
    "kill nodes": FaultInjection.kill_nodes,
    "kill camera": FaultInjection.kill_camera,
    "change source": FaultInjection.change_source,
    "clock back": FaultInjection.set_clock_back,
    "parameters": FaultInjection.set_parameters,
    "two cameras": FaultInjection.add_camera,
    "stopped subscriber": FaultInjection.stop_subscriber,
}


def faults(random_: random.Random, trials: int, names: Sequence[str] = tuple(FAULTS)[1:]) -> Iterator[str]:
    """The start, then these faults again and again, each time in another order."""
    yield "start"
    orders = (random_.sample(names, len(names)) for _ in itertools.count())
    yield from itertools.islice(itertools.chain.from_iterable(orders), trials)


@contextmanager
def injection(shape: str, table: Table, random_: random.Random) -> Iterator[FaultInjection]:
    """The graph of a shape."""
    with tempfile.TemporaryDirectory() as folder:
        nodes = Nodes(shape, Path(folder))
        faulty = FaultInjection(nodes, table, random_)
        try:
            yield faulty
        finally:
            faulty.close()
            nodes.stop()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the trials, print a table for each shape; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120.0, help="of each shape")
    parser.add_argument("--trials", type=int, default=10_000, help="of each shape, at most")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--shapes", nargs="+", default=list(SHAPES), choices=list(SHAPES))
    parser.add_argument("--faults", nargs="+", default=tuple(FAULTS)[1:], choices=tuple(FAULTS)[1:])
    options = parser.parse_args(arguments)
    rclpy.init()
    failed = False
    for shape in options.shapes:
        table, random_ = Table(), random.Random(options.seed)
        with injection(shape, table, random_) as faulty:
            end = time.monotonic() + options.seconds
            for fault in faults(random_, options.trials, options.faults):
                faulty.run(fault)
                if time.monotonic() > end:
                    break
        print(f"{shape}\n{table}", flush=True)
        failed |= table.failed
    rclpy.shutdown()
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
