"""Evaluation on Ray beside the plain one with as many workers, training by number of collectors, and what delays cost. On a quiet machine:

    pip install "wad-cosim[ray]" torch
    python ray_scale.py                                  # nodes of one core: 1, 2, 4
    python ray_scale.py --nodes 2 --delays 0 10 100      # ms before each event of Ray's processes, by Ray's own setting for tests
    python ray_scale.py --nodes 1 2 --train 20000        # steps, with one collector for each node
    python ray_scale.py --learner                        # the learner alone: what a turn and an update cost it, and the bytes of both ways

Prints tables for docs/cluster.md: medians over the turns; in a turn the plain evaluation and Ray follow each other.
"""

import argparse
import json
import os
import pathlib
import pickle
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable

# Before Ray is imported: on loopback, with a token; and with the priority of the plain evaluation.
os.environ.update(
    RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER="0",
    RAY_AUTH_MODE="token",
    RAY_AUTH_TOKEN=uuid.uuid4().hex,
    RAY_USAGE_STATS_ENABLED="0",
    RAY_worker_niceness="0",
    OMP_NUM_THREADS="1",
)
from ray.cluster_utils import Cluster  # noqa: E402

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--nodes", type=int, nargs="+", default=[1, 2, 4])
parser.add_argument("--turns", type=int, default=3)
parser.add_argument("--suite", default="composite")
parser.add_argument("--agent", default="autopilot")
parser.add_argument("--episodes", type=int, default=48, help="of the suite's first condition, in one weather")
parser.add_argument("--delays", type=float, nargs="*", default=[], metavar="MS")
parser.add_argument("--train", type=int, default=0, metavar="STEPS")
parser.add_argument("--update-ratio", type=float, default=1.0, help="of the training: lower, and the learner is not the limit")
parser.add_argument("--learner", action="store_true", help="without Ray")
options = parser.parse_args()

PART = {"condition": "training", "weather": "ClearNoon", "seed": 3, "episodes": options.episodes}
PLAIN = "import json, sys, wad_cosim; wad_cosim.evaluate(**json.loads(sys.argv[1]))"


def seconds(*command: str) -> float:
    """Wall time of a command, its start included."""
    began = time.monotonic()
    subprocess.run([sys.executable, *command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.monotonic() - began


def rates(out: pathlib.Path, wall: float) -> tuple[float, float]:
    """Episodes an hour, and steps a second."""
    lines = [json.loads(line) for line in (out / "episodes.jsonl").read_text().splitlines()]
    return 3600 * len(lines) / wall, sum(line["ticks"] for line in lines) / wall


def plain(workers: int, out: pathlib.Path) -> tuple[float, float]:
    wanted = {**PART, "suite": options.suite, "agent": options.agent, "jobs": workers, "out": str(out), "keep": "none"}
    return rates(out, seconds("-c", PLAIN, json.dumps(wanted)))


class Nodes:
    """A cluster of nodes of one core, and a head without any."""

    def __init__(self, count: int, delay: float = 0.0) -> None:
        os.environ["RAY_testing_asio_delay_us"] = f"*={1000 * delay:.0f}:{1000 * delay:.0f}" if delay else ""
        head = {"num_cpus": 0, "include_dashboard": False, "node_ip_address": "127.0.0.1"}
        self._cluster = Cluster(initialize_head=True, head_node_args=head)
        for _ in range(count):
            self._cluster.add_node(num_cpus=1, node_ip_address="127.0.0.1")

    def __enter__(self) -> str:
        return str(self._cluster.address)

    def __exit__(self, *_: object) -> None:
        self._cluster.shutdown()


def on_ray(address: str, workers: int, out: pathlib.Path) -> tuple[float, float]:
    part = [text for name, value in PART.items() for text in (f"--{name}", str(value))]
    command = ["-m", "wad_cosim.ray", "eval", options.suite, "--agent", options.agent, *part, "--keep", "none"]
    return rates(out, seconds(*command, "--address", address, "--workers", str(workers), "--out", str(out)))


def trained(address: str, collectors: int, out: pathlib.Path) -> float:
    """Steps a second that the learner took, its starts left out."""
    command = ["-m", "wad_cosim.ray", "train", "--algo", "sac", "--seed", "1", "--steps", str(options.train)]
    command += ["--update-ratio", str(options.update_ratio)]
    seconds(*command, "--learning-starts", "1000", "--address", address, "--workers", str(collectors), "--out", str(out))
    lines = [json.loads(line) for line in (out / "train.jsonl").read_text().splitlines()]
    return statistics.median(line["charts/SPS"] for line in lines if "charts/SPS" in line)


def learner(observation: str, turns: int = 300, updates: int = 300) -> tuple[float, ...]:
    """Bytes of a turn of 128 steps and of the weights, ms to read a turn and put it into the buffer, to pack the weights, and for an update."""
    import numpy as np
    from wad_cosim.learn.replay import Segment
    from wad_cosim.learn.training import RAW, Learner, Settings, latent_size

    rng, size = np.random.default_rng(1), latent_size(observation) + RAW
    ready = Settings("sac", observation=observation, learning_starts=128 * turns, update_ratio=updates / 128)

    def turn() -> bytes:
        def segment() -> Segment:
            numbers = rng.standard_normal((ready.segment + 1, size), dtype=np.float32)
            actions = rng.random((ready.segment, 3), dtype=np.float32)
            return Segment(numbers, actions, np.zeros(ready.segment, np.float32), False, rng.integers(1, 10_000, ready.segment))

        return pickle.dumps([segment() for _ in range(ready.egos)])

    def spent(times: int, act: Callable[[], object]) -> float:
        begin = time.perf_counter()
        for _ in range(times):
            act()
        return 1000 * (time.perf_counter() - begin) / times

    taught, sent = Learner(ready), [turn() for _ in range(turns)]
    packed = len(pickle.dumps(taught.published().weights))
    waiting = iter(sent)
    take = spent(turns, lambda: taught.take(pickle.loads(next(waiting))))
    pack = spent(100, lambda: pickle.dumps(taught.published().weights))
    update = (spent(1, lambda: taught.take(pickle.loads(turn()))) - take) / updates
    return len(sent[0]), packed, take, pack, update


def row(*cells: object) -> None:
    print("|", *(f"{cell:.1f} |" if isinstance(cell, float) else f"{cell} |" for cell in cells), flush=True)


def median(pairs: list[tuple[float, float]]) -> tuple[float, float]:
    return statistics.median(pair[0] for pair in pairs), statistics.median(pair[1] for pair in pairs)


with tempfile.TemporaryDirectory() as folder:
    new = iter(pathlib.Path(folder) / str(number) for number in range(10_000))
    what = "the learner alone" if options.learner else f"WAD-S, {options.train} steps, {options.update_ratio:g} updates for a step" if options.train else f"{options.suite}, {options.agent}, {options.episodes} episodes"
    print(f"{what}, {options.turns} turns; load {os.getloadavg()[0]:.1f}\n")
    if options.learner:
        row("observation", "turn, bytes", "weights, bytes", "turn taken, ms", "weights packed, ms", "update, ms")
        row(*["---:"] * 6)
        for observation in ("raw", "vector", "latent"):
            row(observation, *(f"{number:.2f}" if number < 1000 else number for number in learner(observation)))
    elif options.delays:
        row("delay (ms)", "nodes", "episodes/h", "steps/s")
        row("---:", "---:", "---:", "---:")
        for count in options.nodes:
            for delay in options.delays:
                with Nodes(count, delay) as address:
                    row(delay, count, *median([on_ray(address, count, next(new)) for _ in range(options.turns)]))
    elif options.train:
        row("collectors", "steps/s")
        row("---:", "---:")
        for count in options.nodes:
            # And one for the learner.
            with Nodes(count + 1) as address:
                row(count, statistics.median(trained(address, count, next(new)) for _ in range(options.turns)))
    else:
        row("workers", "plain, episodes/h", "steps/s", "Ray, episodes/h", "steps/s", "more time on Ray")
        row(*["---:"] * 6)
        for count in options.nodes:
            with Nodes(count) as address:
                found = [(plain(count, next(new)), on_ray(address, count, next(new))) for _ in range(options.turns)]
            without, within = median([pair[0] for pair in found]), median([pair[1] for pair in found])
            row(count, *without, *within, f"{100 * (without[0] / within[0] - 1):.0f} %")
print(f"\nload at the end {os.getloadavg()[0]:.1f}")
