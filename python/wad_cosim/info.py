"""``info``: facts for logs, tables and people, never for the agent.

Every ``info`` has ``tick`` (ticks of the episode so far), ``time`` (SUMO's clock, s), ``speed`` (m/s), ``driven`` (m along the
route), ``route_done`` (its share, 0 to 1), ``vehicles`` and ``pedestrians`` (in the net), ``x``, ``y`` (m) and ``heading`` (rad, counter-clockwise from east) in the
net's frame, and ``reward_terms`` (by name).
A tick with events has ``events``, a list of dictionaries. The last tick of an episode has ``end`` (arrival, survived,
collision, red_light, outside_lane, sidewalk, vehicle_blocked, timeout or error), ``cause`` (its reason as text) and
``success``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native

REWARD, TERMINATED, TRUNCATED = 0, 1, 2
_TERMS = _native.NUMBERS.index("timeout")
_NAMES = [(i, name) for i, name in enumerate(_native.NUMBERS[:_TERMS]) if i > TRUNCATED]
_TERM_NAMES = list(enumerate(_native.NUMBERS[_TERMS:], _TERMS))
#: The reward's parts.
TERMS = tuple(name for _, name in _TERM_NAMES)


def of(numbers: NDArray[np.float64]) -> dict[str, Any]:
    """The ``info`` of an environment's row of numbers."""
    return _native.info_of(numbers)


def add_news(info: dict[str, Any], events: list[dict[str, Any]], ending: tuple[str, str, bool] | None) -> None:
    """Adds what seldom happens."""
    if events:
        info["events"] = events
    if ending is not None:
        info["end"], info["cause"], info["success"] = ending


def of_all(numbers: NDArray[np.float64], chosen: NDArray[np.bool_]) -> dict[str, Any]:
    """The same for many environments, as Gymnasium's vector environments have it: an array by name, and under
    ``_name`` the environments that have a value, one array for all names."""
    columns = numbers.T.copy()
    has = chosen.copy()
    if not has.all():
        columns[:, ~has] = 0
    info: dict[str, Any] = {}
    for i, name in _NAMES:
        info[name] = columns[i].astype(int) if name in _native.WHOLE else columns[i]
        info["_" + name] = has
    terms: dict[str, Any] = {}
    for i, name in _TERM_NAMES:
        terms[name], terms["_" + name] = columns[i], has
    info["reward_terms"], info["_reward_terms"] = terms, has
    return info
