"""Where transitions began, so that batches can be drawn from where episodes end: 10 m of ground, and the quarter of the compass that the ego
faces there."""

from __future__ import annotations

import collections
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Nowhere that is known.
UNKNOWN = 0
#: Side of a place (m).
SIDE = 10.0

Places = NDArray[np.int64]


def of(x: Any, y: Any, heading: Any) -> Places:
    """The places of egos at ``x``, ``y`` (m) with ``heading`` (rad), arrays of one shape."""
    east, north = (np.floor(np.asarray(part) / SIDE).astype(np.int64) & 0x1FFF for part in (x, y))
    quarter = np.round(np.asarray(heading) / (np.pi / 2)).astype(np.int64) & 3
    return np.asarray(1 << 31 | east << 15 | north << 2 | quarter, np.int64)


class Visits:
    """The entries of a ring by place, oldest first."""

    def __init__(self) -> None:
        self._entries: dict[int, collections.deque[int]] = {}

    def add(self, place: int, entry: int) -> None:
        """``entry``, the newest, is at ``place``."""
        if place != UNKNOWN:
            self._entries.setdefault(place, collections.deque()).append(entry)

    def forget(self, place: int, entry: int) -> None:
        """``entry``, the oldest of all, is overwritten."""
        entries = self._entries.get(place)
        if entries and entries[0] == entry:
            entries.popleft()
            if not entries:
                del self._entries[place]

    def at(self, place: int) -> collections.deque[int] | None:
        """All entries at ``place``; None where it is unknown."""
        return self._entries.get(place)
