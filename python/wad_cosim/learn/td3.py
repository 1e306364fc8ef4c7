"""TD3 (Fujimoto, van Hoof and Meger 2018): WAD-T, in the paper's order. One update is that of ``wad-cosim train agent``; a test holds
both to each other. docs/agents.md says what is not in the papers."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .exploration import Noise
from .networks import ACTIONS, HALF, HIGH, LOW, MIDDLE, RAW, START, Critic, DrivingActor, chain, descend, follow, latent_size
from .replay import Batch


@dataclass(frozen=True)
class Params:
    """The constants, as in an agent's file."""

    gamma: float = 0.98
    tau: float = 0.005
    actor_learning_rate: float = 3e-4
    critic_learning_rate: float = 3e-4
    #: Noise on the target's action and its bound, in halves of an action's range.
    policy_noise: float = 0.1
    noise_clip: float = 0.25
    #: Updates of the critics for one of the actor.
    policy_frequency: int = 2
    #: Weight of the penalty on outputs at the flat ends of their sigmoids.
    saturation: float = 0.01
    critic_hidden: list[int] = field(default_factory=lambda: [256, 128])
    #: The returns at the ends of the critics' sigmoid.
    critic_end: dict[str, Any] = field(default_factory=lambda: {"kind": "sigmoid", "low": -60.0, "high": 100.0})


class Actor(DrivingActor):
    """Latent 200 - 150 - 100 and raw states 15 - 50, then both - 100 - 75 - 3: steering tanh, throttle and brake sigmoids."""

    def __init__(self, observation: str) -> None:
        latent = latent_size(observation)
        branches = [*(chain(latent, 150, 100) if latent else ()), *chain(RAW, 50)]
        super().__init__(observation, nn.ModuleList([*branches, *chain(150 if latent else 50, 100, 75, ACTIONS)]), START)

    def outputs(self, observation: Tensor) -> Tensor:
        """What goes into tanh and sigmoids."""
        *branches, raw, joined, between, last = self.layers
        x = observation[:, : self.latent]
        for layer in branches:
            x = F.relu(layer(x))
        x = torch.cat([x, F.relu(raw(observation[:, self.latent :]))], -1)
        out: Tensor = last(F.relu(between(F.relu(joined(x)))))
        return out

    @staticmethod
    def squash(outputs: Tensor) -> Tensor:
        """sigmoid(x) = (1 + tanh(x / 2)) / 2, so that one tanh does for all."""
        return torch.tanh(outputs * HALF) * HALF + MIDDLE

    def forward(self, observation: Tensor) -> Tensor:
        return self.squash(self.outputs(observation))

    def explore(self, observation: Tensor, noise: Noise) -> Tensor:
        """Actions with this tick's noise, not yet cut to their ranges."""
        return self.forward(observation) + torch.from_numpy(noise.added())


class TD3(nn.Module):
    """Actor, critics and their targets."""

    name = "wad-t"

    def __init__(self, observation: str, params: Params | None = None) -> None:
        super().__init__()
        self.params = params or Params()
        self.actor = Actor(observation)
        self.qf1, self.qf2 = (Critic(observation, *self.params.critic_hidden) for _ in range(2))
        self.actor_target = copy.deepcopy(self.actor).requires_grad_(False)
        self.qf1_target, self.qf2_target = (copy.deepcopy(qf).requires_grad_(False) for qf in (self.qf1, self.qf2))
        critics = [*self.qf1.parameters(), *self.qf2.parameters()]
        self.optimizers: dict[str, torch.optim.Optimizer] = {
            "critics": torch.optim.Adam(critics, lr=self.params.critic_learning_rate),
            "actor": torch.optim.Adam(self.actor.parameters(), lr=self.params.actor_learning_rate),
        }
        self.updates = 0

    def update(self, batch: Batch) -> dict[str, float]:
        """One update of the critics, every second time of the actor too; the losses by their names in logs."""
        p, (low, high) = self.params, (self.params.critic_end["low"], self.params.critic_end["high"])
        self.updates += 1

        # Target policy smoothing: a' = pi'(s') + clipped noise.
        with torch.no_grad():
            noise = (batch.noise * p.policy_noise).clamp(-p.noise_clip, p.noise_clip) * HALF
            action = torch.clamp(self.actor_target(batch.next_observation) + noise, LOW, HIGH)
            # Clipped double Q-learning: y = r + gamma (1 - terminated) min(Q1', Q2')(s', a').
            q = torch.min(self.qf1_target(batch.next_observation, action), self.qf2_target(batch.next_observation, action))
            y = batch.reward + batch.discount * (torch.sigmoid(q) * (high - low) + low)
            y = ((y - low) / (high - low)).clamp(0, 1)
        qf1_loss, qf2_loss = (
            F.mse_loss(torch.sigmoid(qf(batch.observation, batch.action)), y) for qf in (self.qf1, self.qf2)
        )
        descend((self.optimizers["critics"], qf1_loss + qf2_loss))
        losses = {"losses/qf1_loss": qf1_loss.item(), "losses/qf2_loss": qf2_loss.item()}

        # Delayed policy updates: the actor climbs Q1, and the targets follow.
        if self.updates % p.policy_frequency == 0:
            outputs = self.actor.outputs(batch.observation)
            # Beyond 2 a tanh passes less than 7 % of a gradient.
            flat = F.relu((outputs * HALF).abs() - 2).square().mean()
            q = torch.sigmoid(self.qf1(batch.observation, self.actor.squash(outputs)))
            actor_loss = p.saturation * flat - q.mean()
            descend((self.optimizers["actor"], actor_loss))
            losses["losses/actor_loss"] = actor_loss.item()
            follow(self.actor_target, self.actor, p.tau)
            follow(self.qf1_target, self.qf1, p.tau)
            follow(self.qf2_target, self.qf2, p.tau)
        return losses
