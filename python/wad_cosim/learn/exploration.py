"""Noise that explores a road at six decisions a second (docs/agents.md, "Exploration"): it lasts about five ticks, because a second of
white noise undoes itself. Each episode draws its share of it; a fifth of the episodes have none."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .networks import ACTIONS

#: Standard deviations of the noise on steering, throttle and brake.
DEVIATION = np.array([0.08, 0.15, 0.10])
CORRELATION = 0.8
QUIET_EPISODES = 0.2
#: Actions before learning starts: gently forward, the brake on now and then.
START_MEAN, START_DEVIATION = np.array([0.0, 0.45, -0.35]), np.array([0.08, 0.25, 0.4])


class Noise:
    """The noise of ``egos`` egos."""

    def __init__(self, egos: int, rng: np.random.Generator) -> None:
        self._rng = rng
        #: Standard normal, correlated over time, (egos, 3).
        self.state = np.zeros((egos, ACTIONS), np.float32)
        self._share = np.zeros((egos, 1))
        self.reset(np.ones(egos, np.bool_))

    def _normal(self, *shape: int) -> NDArray[np.float32]:
        return self._rng.standard_normal(shape, dtype=np.float32)

    def reset(self, began: NDArray[np.bool_]) -> None:
        """Draws the noise of the episodes that begin."""
        n = int(began.sum())
        self.state[began] = self._normal(n, ACTIONS)
        self._share[began] = np.where(self._rng.random((n, 1)) < QUIET_EPISODES, 0, self._rng.random((n, 1)))

    def advance(self) -> None:
        """Goes on by a tick."""
        new = self._normal(*self.state.shape)
        self.state = np.float32(CORRELATION) * self.state + np.float32(np.sqrt(1 - CORRELATION**2)) * new

    def added(self) -> NDArray[np.float32]:
        """What WAD-T adds to its actions."""
        return np.asarray(self._share * DEVIATION * self.state, np.float32)

    def start(self) -> NDArray[np.float32]:
        """Actions before learning starts, not yet cut to their ranges."""
        return np.asarray(START_MEAN + START_DEVIATION * self.state, np.float32)
