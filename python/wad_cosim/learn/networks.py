"""What the networks of both agents share."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .._native import InputError

RAW, ACTIONS = 15, 3
#: Numbers of an observation before the raw states.
LATENT = {"raw": 0, "vector": 172, "latent": 200}
#: Half of each action's range, and its middle: steering -1 to 1, throttle and brake 0 to 1.
HALF, MIDDLE = torch.tensor([1.0, 0.5, 0.5]), torch.tensor([0.0, 0.5, 0.5])
LOW, HIGH = MIDDLE - HALF, MIDDLE + HALF
#: A new actor's outputs, before they are squashed: straight on, throttle sigmoid(-0.6), brake sigmoid(-3). It creeps forward.
START = torch.tensor([0.0, -0.6, -3.0])


def chain(*sizes: int) -> nn.ModuleList:
    """Fully connected layers; torch draws their weights uniformly from +-1 / sqrt(inputs)."""
    return nn.ModuleList(nn.Linear(inputs, outputs) for inputs, outputs in zip(sizes, sizes[1:]))


def through(layers: nn.ModuleList, x: Tensor) -> Tensor:
    """``x`` through the layers, with ReLU between them."""
    for layer in layers[:-1]:
        x = F.relu(layer(x))
    out: Tensor = layers[-1](x)
    return out


class DrivingActor(nn.Module):
    """An actor with the scale of its inputs: x' = (x - offset) factor. Its layers are in the order of the agent's file."""

    offset: Tensor
    factor: Tensor

    def __init__(self, observation: str, layers: nn.ModuleList, biases: Tensor) -> None:
        super().__init__()
        self.latent, self.layers = latent_size(observation), layers
        self.register_buffer("offset", torch.zeros(self.latent + RAW))
        self.register_buffer("factor", torch.ones(self.latent + RAW))
        # Small, so that the biases set the first action.
        *_, last = self.linears()
        nn.init.uniform_(last.weight, -3e-3, 3e-3)
        with torch.no_grad():
            last.bias.copy_(biases)

    def linears(self) -> Iterator[nn.Linear]:
        """The layers, as types know them."""
        for layer in self.layers:
            assert isinstance(layer, nn.Linear)
            yield layer

    def scaled(self, observation: Tensor) -> Tensor:
        """What the networks get."""
        return (observation - self.offset) * self.factor

    def measure(self, observations: Tensor, gain: float) -> None:
        """Scales the latent to the deviation ``gain`` in these observations. Numbers that hardly vary are not amplified: the smallest
        deviation used is a tenth of the mean one."""
        latents = observations[:, : self.latent]
        deviation = latents.std(0, correction=0)
        self.offset[: self.latent] = latents.mean(0)
        self.factor[: self.latent] = gain / torch.clamp(deviation, min=max(0.1 * float(deviation.mean()), 1e-6))


class Critic(nn.Module):
    """Observation and action to one number."""

    def __init__(self, observation: str, *hidden: int) -> None:
        super().__init__()
        self.layers = chain(latent_size(observation) + RAW + ACTIONS, *hidden, 1)

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        return through(self.layers, torch.cat([observation, action], -1)).squeeze(-1)


def latent_size(observation: str) -> int:
    """Numbers before the raw states."""
    if observation not in LATENT:
        raise InputError(f"observation={observation!r}: expected one of {', '.join(LATENT)}")
    return LATENT[observation]


def descend(*losses: tuple[torch.optim.Optimizer, Tensor]) -> None:
    """A step of each optimiser down its own loss. All gradients are of the parameters before the first step."""
    for optimizer, loss in losses:
        parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
        for parameter, gradient in zip(parameters, torch.autograd.grad(loss, parameters)):
            parameter.grad = gradient
    for optimizer, _ in losses:
        optimizer.step()


@torch.no_grad()
def follow(target: nn.Module, network: nn.Module, tau: float) -> None:
    """target = (1 - tau) target + tau network."""
    for slow, parameter in zip(target.parameters(), network.parameters()):
        slow.lerp_(parameter, tau)
