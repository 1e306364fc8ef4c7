"""Evaluation on Ray: the driver has the folder, actors drive the episodes."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from .. import _native
from . import cluster

Driven = tuple[bytes, tuple[bytes, bytes] | None]


#: A Ray worker that ends kills its children by SIGKILL, and an external agent's guard could not end what the agent has started. Our
#: children end with their parent by themselves.
_SPARE_CHILDREN = {"env_vars": {"RAY_kill_child_processes_on_worker_exit": "0"}}


def _worker(manifest: str, encoder: str, keep: str, agent_timeout: float, act: Any) -> Callable[[str], Driven]:
    return _native.Worker(manifest, encoder, keep, agent_timeout, act).drive


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
    given = (ledger.manifest, wanted["encoder"], keep, wanted["agent_timeout"], act)
    # Workers with an environment of their own start anew, where Ray has others ready: only for those that need it.
    external = act is None and any(agent.startswith("exec:") for agent in wanted["selection"]["agents"])
    runtime_env = _SPARE_CHILDREN if external else None
    bar = cluster.Progress("episodes", ledger.done, ledger.planned, progress)

    def take(driven: Driven) -> int:
        ledger.add(*driven)
        return ledger.done

    try:
        with cluster.connected(address, workers):
            # Again for results that were lost with their node.
            while left := ledger.left():
                cluster.share(left, _worker, given, workers, limit, bar, take, runtime_env)
            bar.show(last=True)
    except KeyboardInterrupt:
        ledger.finish()
        raise
    summary: dict[str, Any] = json.loads(ledger.finish())
    return summary
