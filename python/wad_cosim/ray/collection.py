"""Collecting a dataset on Ray: the driver has the folder, actors drive the segments."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .. import _native
from . import cluster

Driven = tuple[str, bytes]


def _worker(wanted: str, identity: str) -> Callable[[str], Driven]:
    collector = _native.Collector(wanted, identity)
    return lambda segment: (segment, collector.drive(segment))


def collect(
    wanted: dict[str, Any],
    *,
    address: str,
    workers: int | None = None,
    limit: float = cluster.LIMIT,
    progress: bool = False,
) -> dict[str, Any]:
    """Collects the dataset ``wanted``, or goes on with it, as ``wad-cosim dataset collect`` does; returns what is there.

    A segment that takes longer than ``limit`` seconds counts as hung. The driver writes each shard once. Ctrl-C keeps what is written.
    """
    text = json.dumps(wanted)
    collection = _native.Collection(text)
    missing, frames = collection.missing()
    bar = cluster.Progress("frames", frames, collection.wanted, progress)

    def take(driven: Driven) -> int:
        segment, shard = driven
        return bar.done + (json.loads(segment)["frames"] if collection.put(segment, shard) else 0)

    interrupted = False
    try:
        with cluster.connected(address, workers):
            while missing:
                cluster.share(missing, _worker, (text, collection.identity), workers, limit, bar, take)
                # Again for shards that were lost with their node.
                missing, _ = collection.missing()
            bar.show(last=True)
    except KeyboardInterrupt:
        interrupted = True
    collected: dict[str, Any] = json.loads(collection.finish(interrupted))
    return collected
