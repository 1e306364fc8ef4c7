"""SAC in its first form (Haarnoja et al. 2018), with a value network: WAD-S, in the paper's order. One update is that of ``wad-cosim
train agent``; a test holds both to each other. docs/agents.md says what is not in the papers."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .exploration import Noise
from .networks import ACTIONS, HALF, MIDDLE, RAW, START, Critic, DrivingActor, chain, descend, follow, latent_size, through
from .replay import Batch

HIDDEN = (256, 128, 64)
#: Bounds of the logarithm of the standard deviations; a tanh moves between them.
LOG_STD = (-5.0, 2.0)
#: What goes into that tanh at first: a log standard deviation of -1.
START_LOG_STD = 0.145


@dataclass(frozen=True)
class Params:
    """The constants, as in an agent's file."""

    gamma: float = 0.98
    tau: float = 0.005
    learning_rate: float = 3e-4
    #: The first temperature, scaled reward per nat of entropy.
    alpha: float = 0.1
    #: Of actions in -1 to 1: minus their number (nats).
    target_entropy: float = -float(ACTIONS)


class Actor(DrivingActor):
    """The policy, a squashed gaussian: observation - 256 - 128 - 64 - 3 means and 3 log standard deviations."""

    def __init__(self, observation: str) -> None:
        # Pedals are rescaled tanhs here: half of a sigmoid's argument.
        biases = torch.cat([START * HALF, torch.full([ACTIONS], START_LOG_STD)])
        super().__init__(observation, chain(latent_size(observation) + RAW, *HIDDEN, 2 * ACTIONS), biases)

    def distribution(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations, before the squashing."""
        mean, log_std = through(self.layers, observation).chunk(2, -1)
        low, high = LOG_STD
        return mean, torch.tanh(log_std) * (0.5 * (high - low)) + 0.5 * (high + low)

    def forward(self, observation: Tensor) -> Tensor:
        return torch.tanh(self.distribution(observation)[0]) * HALF + MIDDLE

    def explore(self, observation: Tensor, noise: Noise) -> Tensor:
        """Actions drawn with this tick's noise."""
        return self.sample(observation, torch.from_numpy(noise.state))[0]

    def sample(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Actions drawn with standard normal ``noise``, and their log-probabilities, the density taken over -1 to 1 for all three:

        u = mean + std n;  log pi = sum(log N(u) - log(1 - tanh(u)^2))
        """
        mean, log_std = self.distribution(observation)
        u = mean + log_std.exp() * noise
        gaussian = -0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi)
        # log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)), which does not lose its digits.
        squashed = 2 * (math.log(2) - u - F.softplus(-2 * u))
        return torch.tanh(u) * HALF + MIDDLE, (gaussian - squashed).sum(-1)


class Value(nn.Module):
    """Observation - 256 - 128 - 64 - 1."""

    def __init__(self, observation: str) -> None:
        super().__init__()
        self.layers = chain(latent_size(observation) + RAW, *HIDDEN, 1)

    def forward(self, observation: Tensor) -> Tensor:
        return through(self.layers, observation).squeeze(-1)


class SAC(nn.Module):
    """Policy, critics, and the value network with its target."""

    name = "wad-s"

    def __init__(self, observation: str, params: Params | None = None) -> None:
        super().__init__()
        self.params = params or Params()
        self.actor = Actor(observation)
        self.qf1, self.qf2 = (Critic(observation, *HIDDEN) for _ in range(2))
        self.value = Value(observation)
        self.value_target = copy.deepcopy(self.value).requires_grad_(False)
        self.log_alpha = nn.Parameter(torch.tensor([math.log(self.params.alpha)]))

        def adam(*parameters: nn.Parameter) -> torch.optim.Optimizer:
            return torch.optim.Adam(parameters, lr=self.params.learning_rate)

        self.optimizers: dict[str, torch.optim.Optimizer] = {
            "critics": adam(*self.qf1.parameters(), *self.qf2.parameters()),
            "value": adam(*self.value.parameters()),
            "actor": adam(*self.actor.parameters()),
            "alpha": adam(self.log_alpha),
        }
        self.updates = 0

    def update(self, batch: Batch) -> dict[str, float]:
        """One update of every network; the losses by their names in logs."""
        self.updates += 1
        alpha = self.log_alpha.detach().exp()

        # Q: r + gamma (1 - terminated) V'(s')
        with torch.no_grad():
            y = batch.reward + batch.discount * self.value_target(batch.next_observation)
        qf1_loss, qf2_loss = (F.mse_loss(qf(batch.observation, batch.action), y) for qf in (self.qf1, self.qf2))

        # pi: alpha log pi(a|s) - min Q(s, a), with a new sample a
        action, log_prob = self.actor.sample(batch.observation, batch.noise)
        q = torch.min(self.qf1(batch.observation, action), self.qf2(batch.observation, action))
        actor_loss = (alpha * log_prob - q).mean()

        # V: min Q(s, a) - alpha log pi(a|s)
        vf_loss = 0.5 * F.mse_loss(self.value(batch.observation), (q - alpha * log_prob).detach())

        # alpha: the entropy comes to its target
        alpha_loss = -self.log_alpha * (log_prob.detach().mean() + self.params.target_entropy)

        descend(
            (self.optimizers["critics"], 0.5 * (qf1_loss + qf2_loss)),
            (self.optimizers["value"], vf_loss),
            (self.optimizers["actor"], actor_loss),
            (self.optimizers["alpha"], alpha_loss),
        )
        follow(self.value_target, self.value, self.params.tau)
        return {
            "losses/qf1_loss": qf1_loss.item(),
            "losses/qf2_loss": qf2_loss.item(),
            "losses/actor_loss": actor_loss.item(),
            "losses/vf_loss": vf_loss.item(),
            "losses/alpha": alpha.item(),
            "losses/entropy": -log_prob.mean().item(),
        }
