"""The replay buffer: segments of episodes in, batches out.

A segment is some transitions of one episode in a row, and the observation after the last: each observation is stored once. A
transition's next observation is the following entry; the last entry of a segment has no action and is never drawn itself.
"""

from __future__ import annotations

import collections
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .._native import InputError
from .networks import ACTIONS
from .places import UNKNOWN, Places, Visits

#: What an entry is.
_END, _MIDDLE, _TERMINATION = 0, 1, 2
#: How many transitions before a termination lead to it: about seven seconds, in which it can still be averted.
NEAR = 40


class Segment(NamedTuple):
    """``n`` transitions of one episode in a row."""

    #: (n + 1, D)
    observations: NDArray[np.float32]
    #: (n, 3)
    actions: NDArray[np.float32]
    #: (n,)
    rewards: NDArray[np.float32]
    #: The last transition ended the task: the value of the next state is 0. After a truncation it is not.
    terminated: bool
    #: Where each transition began, (n,); None: not known.
    places: Places | None = None
    #: Of one that terminated: where the last :data:`NEAR` transitions of its episode began, those of its earlier segments included. None:
    #: those of this segment are all that is known.
    lead: Places | None = None


class Batch(NamedTuple):
    """One update's transitions."""

    #: (B, D)
    observation: Tensor
    #: (B, 3)
    action: Tensor
    #: The sum over the next ticks, discounted, (B,).
    reward: Tensor
    #: The observation after them, (B, D).
    next_observation: Tensor
    #: gamma^n, or 0 where the episode terminated, (B,).
    discount: Tensor
    #: Standard normal, (B, 3): the update's only randomness.
    noise: Tensor


class ReplayBuffer:
    """A ring of ``capacity`` entries of observations with ``size`` numbers."""

    def __init__(self, capacity: int, size: int) -> None:
        if capacity < 1024:
            raise InputError(f"a replay buffer of {capacity} transitions: expected 1024 or more")
        # The system gives the pages as they are touched.
        self._observations = np.zeros((capacity, size), np.float32)
        self._actions = np.zeros((capacity, ACTIONS), np.float32)
        self._rewards = np.zeros(capacity, np.float32)
        self._kinds = np.zeros(capacity, np.uint8)
        self._places = np.full(capacity, UNKNOWN, np.int64)
        self._visits = Visits()
        #: The entries that are terminations, oldest first, each with the places that lead to it. They are kept here since other egos'
        #: segments lie between those of an episode.
        self._terminations: collections.deque[tuple[int, Places]] = collections.deque()
        self._written = 0

    def __len__(self) -> int:
        return min(self._written, len(self._kinds))

    def push(self, segment: Segment) -> None:
        """Adds a segment; it replaces the oldest entries of a full buffer."""
        n = len(segment.actions)
        at = (self._written + np.arange(n + 1)) % len(self._kinds)
        self._forget(at)
        self._places[at[:n]] = UNKNOWN if segment.places is None else segment.places
        self._places[at[n]] = UNKNOWN
        self._observations[at] = segment.observations
        self._actions[at[:n]] = segment.actions
        self._rewards[at[:n]] = segment.rewards
        self._kinds[at[:n]], self._kinds[at[n]] = _MIDDLE, _END
        if segment.terminated:
            self._kinds[at[n - 1]] = _TERMINATION
        self._index(at)
        if segment.terminated:
            lead = self._places[at[:n]] if segment.lead is None else segment.lead
            self._terminations.append((int(at[n - 1]), np.array(lead[-NEAR:])))
        self._written += n + 1

    def _forget(self, overwritten: NDArray[np.intp]) -> None:
        for entry in overwritten.tolist():
            if self._terminations and self._terminations[0][0] == entry:
                self._terminations.popleft()
            self._visits.forget(int(self._places[entry]), entry)

    def _index(self, new: NDArray[np.intp]) -> None:
        for entry in new.tolist():
            self._visits.add(int(self._places[entry]), entry)

    def sample(self, rng: np.random.Generator, size: int, n_step: int, gamma: float, near_ends: float = 0.0) -> Batch:
        """Draws ``size`` transitions with rewards summed over ``n_step`` ticks, the share ``near_ends`` of them where episodes end, the
        others uniformly. All transitions at the places of the last :data:`NEAR` before a termination count, whatever came of them:
        to draw by the outcome would have critics expect it more often than it comes."""
        first = self._draw(rng, size)
        for i in np.flatnonzero(rng.random(size) < near_ends) if self._terminations else ():
            _, lead = self._terminations[int(rng.integers(len(self._terminations)))]
            visits = self._visits.at(int(lead[int(rng.integers(len(lead)))]))
            if visits:
                first[i] = visits[int(rng.integers(len(visits)))]
        reward, discount, running = np.zeros(size), np.ones(size), np.ones(size, np.bool_)
        at = first.copy()
        for _ in range(n_step):
            running &= self._kinds[at] != _END
            reward[running] += (discount * self._rewards[at])[running]
            discount[running] *= gamma
            terminated = running & (self._kinds[at] == _TERMINATION)
            discount[terminated] = 0
            at = np.where(running, (at + 1) % len(self._kinds), at)
            running &= ~terminated
        noise = rng.standard_normal((size, ACTIONS), dtype=np.float32)
        found = (self._observations[first], self._actions[first], reward, self._observations[at], discount, noise)
        return Batch(*(torch.from_numpy(np.asarray(part, np.float32)) for part in found))

    def _draw(self, rng: np.random.Generator, size: int) -> NDArray[np.intp]:
        drawn = rng.integers(len(self), size=size)
        while (ends := self._kinds[drawn] == _END).any():
            drawn[ends] = rng.integers(len(self), size=int(ends.sum()))
        return drawn

    def observations(self, most: int) -> Tensor:
        """At most about ``most`` stored observations, evenly spread."""
        return torch.from_numpy(self._observations[: len(self) : max(len(self) // most, 1)])

    def state(self) -> dict[str, Any]:
        """For a checkpoint."""
        n = len(self)
        parts: dict[str, NDArray[Any]] = {"observations": self._observations, "actions": self._actions}
        parts |= {"rewards": self._rewards, "kinds": self._kinds, "places": self._places}
        terminations = [(entry, torch.from_numpy(lead)) for entry, lead in self._terminations]
        return {
            "written": self._written,
            "terminations": terminations,
            **{name: torch.from_numpy(part[:n]) for name, part in parts.items()},
        }

    def load(self, state: dict[str, Any]) -> None:
        """Takes the state of a buffer of the same capacity."""
        n = len(state["kinds"])
        self._observations[:n] = state["observations"].numpy()
        self._actions[:n] = state["actions"].numpy()
        self._rewards[:n] = state["rewards"].numpy()
        self._kinds[:n] = state["kinds"].numpy()
        self._places[:n] = state["places"].numpy()
        self._written = state["written"]
        oldest = self._written if n == len(self._kinds) else 0
        self._index((oldest + np.arange(n)) % max(n, 1))
        self._terminations.extend((entry, lead.numpy()) for entry, lead in state.get("terminations", ()))
