"""Evaluation, collection and training on a Ray cluster, where workers and nodes may die; see docs/cluster.md.

Ray schedules, retries and moves data. What it does not promise is that a task runs once only, so every result has a key, and
the folder that keeps the results takes each key once.
"""

import os as _os
import sys as _sys

from .._native import InputError as _InputError

#: Where this is 0, Ray's processes listen on the loopback interface only. Ray reads it when it is imported.
_LOOPBACK = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"


def prepare(address: str) -> None:
    """Before Ray is imported: what ``local`` starts is closed to other machines, and reports nothing to Ray's makers."""
    if address != "local":
        return
    if "ray" in _sys.modules and not _sys.modules["ray"].is_initialized() and _os.environ.get(_LOOPBACK) != "0":
        raise _InputError(
            f"Ray is imported already, and what it starts here would listen to the network: set {_LOOPBACK}=0 before "
            "the import, or call ray.init yourself"
        )
    _os.environ.setdefault(_LOOPBACK, "0")
    _os.environ.setdefault("RAY_AUTH_MODE", "token")
    _os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
