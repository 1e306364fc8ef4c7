"""Actions: what an agent's numbers mean.

Every form becomes the three numbers of an agent of wad-cosim: steering -1 to 1 (left positive), throttle 0 to 1, brake
0 to 1. The brake has a free travel of 0.1, and where it brakes it wins over the throttle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ._native import InputError

_STEERING = (-0.6, -0.2, 0.0, 0.2, 0.6)
_PEDALS = ((0.0, 0.6), (0.0, 0.0), (0.5, 0.0))

#: The actions of ``action="discrete"``, one a row: steering, throttle, brake. Action ``3 * s + p`` steers by the
#: s-th of -0.6, -0.2, 0, 0.2, 0.6 and, with p = 0, 1, 2, brakes, rolls or accelerates.
DISCRETE_ACTIONS: NDArray[np.float32] = np.array(
    [(steer, throttle, brake) for steer in _STEERING for throttle, brake in _PEDALS], dtype=np.float32
)
DISCRETE_ACTIONS.setflags(write=False)

#: The values of ``action=``. ``pedal`` is two numbers -1 to 1: the wheel's cube root, so that small corrections are easily
#: found and the whole wheel can be reached, and a pedal that accelerates above 0 and brakes below.
FORMS = ("continuous", "pedal", "discrete")


def of(form: Any) -> tuple[spaces.Space[Any], Callable[[Any, int], NDArray[np.float32]]]:
    """The space of one action, and what turns n of them into an array (n, 3)."""
    if isinstance(form, str):
        if form == "continuous":
            return spaces.Box(np.array([-1, 0, 0], np.float32), np.array([1, 1, 1], np.float32)), _continuous
        if form == "pedal":
            return spaces.Box(np.array([-1, -1], np.float32), np.array([1, 1], np.float32)), _pedal
        if form == "discrete":
            return _discrete(DISCRETE_ACTIONS)
        raise InputError(f"action={form!r}: expected one of {', '.join(FORMS)}, or a table (n, 3) of actions")
    table = np.array(form, dtype=np.float32)
    if table.ndim != 2 or table.shape[1] != 3 or len(table) < 1 or not np.isfinite(table).all():
        raise InputError(
            f"action: a table of actions has the shape (n, 3), a row is steering, throttle and brake; found {table.shape}"
        )
    return _discrete(table)


def _numbers(actions: Any, shape: tuple[int, int]) -> NDArray[np.float32]:
    try:
        numbers = np.asarray(actions, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise InputError(f"an action is not made of numbers: {error}") from None
    if numbers.shape != shape:
        expected = shape if shape[0] != 1 else shape[1:]
        found = numbers.shape if shape[0] != 1 else numbers.shape[1:]
        raise InputError(f"an action of shape {found}: expected {expected}")
    return numbers


def _continuous(actions: Any, n: int) -> NDArray[np.float32]:
    return np.ascontiguousarray(_numbers(actions, (n, 3)))


def _pedal(actions: Any, n: int) -> NDArray[np.float32]:
    numbers = _numbers(actions, (n, 2))
    out = np.empty((n, 3), dtype=np.float32)
    np.power(numbers[:, 0], 3, out=out[:, 0])
    np.maximum(numbers[:, 1], 0, out=out[:, 1])
    np.maximum(-numbers[:, 1], 0, out=out[:, 2])
    return out


def _discrete(table: NDArray[np.float32]) -> tuple[spaces.Space[Any], Callable[[Any, int], NDArray[np.float32]]]:
    def look_up(actions: Any, n: int) -> NDArray[np.float32]:
        indices = np.asarray(actions)
        if indices.dtype.kind not in "iu" or indices.shape != (n,):
            raise InputError(f"an action is a number from 0 to {len(table) - 1}, found {actions!r}")
        if (indices < 0).any() or (indices >= len(table)).any():
            raise InputError(f"an action is a number from 0 to {len(table) - 1}, found {actions!r}")
        chosen: NDArray[np.float32] = table[indices]
        return chosen

    return spaces.Discrete(len(table)), look_up
