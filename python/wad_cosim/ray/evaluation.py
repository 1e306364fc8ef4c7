"""Evaluation on Ray: the driver has the folder, actors drive the episodes."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .. import _native
from . import cluster

Driven = tuple[bytes, tuple[bytes, bytes] | None]


def _worker(manifest: str, encoder: str, keep: str, act: Any) -> Callable[[str], Driven]:
    return _native.Worker(manifest, encoder, keep, act).drive


def evaluate(
    wanted: dict[str, Any],
    act: Any,
    *,
    address: str,
    workers: int | None = None,
    limit: float = cluster.LIMIT,
    progress: bool = False,
) -> dict[str, Any]:
    """Drives the evaluation ``wanted``, as ``_native.evaluate`` does here, and returns the contents of summary.json.

    An episode that takes longer than ``limit`` seconds counts as hung. The driver writes each once, in the order in which they end. Ctrl-C keeps what is written, with its table.
    """
    # Before Ray starts: what is wrong with the arguments or the folder is said at once.
    ledger = _native.Ledger(json.dumps(wanted), act)
    keep = "none" if wanted["out"] is None else wanted["keep"]
    given = (ledger.manifest, wanted["encoder"], keep, act)
    bar = cluster.Progress("episodes", ledger.done, ledger.planned, progress)

    def take(driven: Driven) -> int:
        ledger.add(*driven)
        return ledger.done

    try:
        with cluster.connected(address, workers):
            # Again for results that were lost with their node.
            while left := ledger.left():
                cluster.share(left, _worker, given, workers, limit, bar, take)
            bar.show(last=True)
    except KeyboardInterrupt:
        ledger.finish()
        raise
    summary: dict[str, Any] = json.loads(ledger.finish())
    return summary
