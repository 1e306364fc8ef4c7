"""TD3 in one file, in the paper's order (Fujimoto, van Hoof and Meger 2018): WAD-T learns to drive 400 m of road from reward
alone, and is written as an agent that wad-cosim drives.

    pip install torch
    python td3.py --out agent.safetensors
    wad-cosim run town3 --agent agent.safetensors --detector outlines

It reads the 15 raw states of each tick (docs/python.md) and gives steering, throttle and brake. What is not in the paper on TD3
is WAD-T's: the networks, the sigmoid at the critics' end, rewards summed over three ticks, noise that lasts, and the penalty
on outputs at the flat ends of their sigmoids (docs/agents.md).
"""

import argparse
import copy
import time
from collections import deque

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

import wad_cosim

GAMMA, TAU = 0.98, 0.005  # the discount per tick; Polyak factor of the targets
LEARNING_RATE = 3e-4
POLICY_NOISE, NOISE_CLIP = 0.1, 0.25  # on the target's action, in halves of an action's range
POLICY_FREQUENCY = 2  # updates of the critics for one of the actor
SATURATION = 0.01
BATCH, N_STEP = 128, 3
VALUE_LOW, VALUE_HIGH = -60.0, 100.0  # the returns at the ends of the critics' sigmoid
LOW, HIGH = torch.tensor([-1.0, 0.0, 0.0]), torch.tensor([1.0, 1.0, 1.0])
HALF = (HIGH - LOW) / 2
EXPLORATION, CORRELATION = np.array([0.08, 0.15, 0.10]), 0.8  # deviations of steering, throttle and brake


class Actor(nn.Module):
    """15 raw states - 50 - 100 - 75 - steering (tanh), throttle and brake (sigmoids)."""

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(15, 50), nn.Linear(50, 100), nn.Linear(100, 75), nn.Linear(75, 3)])
        # Small, so that the biases set the first action: straight on with some throttle and no brake.
        nn.init.uniform_(self.layers[-1].weight, -3e-3, 3e-3)
        with torch.no_grad():
            self.layers[-1].bias.copy_(torch.tensor([0.0, -0.6, -3.0]))

    def outputs(self, observation: torch.Tensor) -> torch.Tensor:
        x = observation
        for layer in self.layers[:-1]:
            x = F.relu(layer(x))
        return self.layers[-1](x)

    @staticmethod
    def squash(outputs: torch.Tensor) -> torch.Tensor:
        return torch.cat([torch.tanh(outputs[..., :1]), torch.sigmoid(outputs[..., 1:])], -1)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return self.squash(self.outputs(observation))

    def save(self, path: str, **header: object) -> None:
        """Writes the agent's file."""
        layers = [(layer.weight.detach().numpy(), layer.bias.detach().numpy()) for layer in self.layers]
        wad_cosim.save_agent(path, layers, observation="raw", params={"gamma": GAMMA}, **header)


class Critic(nn.Module):
    """Observation and action - 256 - 128 - 1: the return as a share of the way from VALUE_LOW to VALUE_HIGH."""

    def __init__(self) -> None:
        super().__init__()
        sizes = [nn.Linear(15 + 3, 256), nn.ReLU(), nn.Linear(256, 128), nn.ReLU(), nn.Linear(128, 1), nn.Sigmoid()]
        self.net = nn.Sequential(*sizes)

    def forward(self, observation: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        return self.net(torch.cat([observation, action], -1)).squeeze(-1)


class ReplayBuffer:
    """Transitions of N_STEP ticks: observation, action, summed reward, next observation, and the discount of its value, which
    is 0 after a termination. A truncated episode's last state still has a value."""

    def __init__(self, size: int) -> None:
        self.rows = np.zeros((size, 15 + 3 + 1 + 15 + 1), np.float32)
        self.count = 0
        self.recent: deque[tuple] = deque()

    def add(self, observation, action, reward, next_observation, terminated, truncated) -> None:
        self.recent.append((observation, action, reward))
        over = terminated or truncated
        while len(self.recent) == N_STEP or (over and self.recent):
            rewards = [r for _, _, r in self.recent]
            total = sum(GAMMA**i * r for i, r in enumerate(rewards))
            discount = 0.0 if terminated else GAMMA ** len(rewards)
            first, taken, _ = self.recent.popleft()
            row = self.rows[self.count % len(self.rows)]
            row[:] = np.concatenate([first, taken, [total], next_observation, [discount]])
            self.count += 1

    def sample(self, rng: np.random.Generator) -> tuple[torch.Tensor, ...]:
        drawn = rng.integers(min(self.count, len(self.rows)), size=BATCH)
        rows = torch.from_numpy(self.rows[drawn])
        return rows[:, :15], rows[:, 15:18], rows[:, 18], rows[:, 19:34], rows[:, 34]


class TD3:
    def __init__(self) -> None:
        self.actor, self.qf1, self.qf2 = Actor(), Critic(), Critic()
        self.actor_target = copy.deepcopy(self.actor)
        self.qf1_target, self.qf2_target = copy.deepcopy(self.qf1), copy.deepcopy(self.qf2)
        critics = [*self.qf1.parameters(), *self.qf2.parameters()]
        self.q_optimizer = torch.optim.Adam(critics, lr=LEARNING_RATE)
        self.actor_optimizer = torch.optim.Adam(self.actor.parameters(), lr=LEARNING_RATE)
        self.updates = 0

    def update(self, batch: tuple[torch.Tensor, ...]) -> None:
        observation, action, reward, next_observation, discount = batch
        self.updates += 1

        # Target policy smoothing: a' = pi'(s') + clipped noise.
        with torch.no_grad():
            noise = (torch.randn_like(action) * POLICY_NOISE).clamp(-NOISE_CLIP, NOISE_CLIP) * HALF
            next_action = torch.clamp(self.actor_target(next_observation) + noise, LOW, HIGH)
            # Clipped double Q-learning: y = r + gamma (1 - terminated) min(Q1', Q2')(s', a').
            q = torch.min(self.qf1_target(next_observation, next_action), self.qf2_target(next_observation, next_action))
            y = reward + discount * (q * (VALUE_HIGH - VALUE_LOW) + VALUE_LOW)
            y = ((y - VALUE_LOW) / (VALUE_HIGH - VALUE_LOW)).clamp(0, 1)
        loss = F.mse_loss(self.qf1(observation, action), y) + F.mse_loss(self.qf2(observation, action), y)
        self.q_optimizer.zero_grad()
        loss.backward()
        self.q_optimizer.step()

        # Delayed policy updates: the actor climbs Q1, and the targets follow.
        if self.updates % POLICY_FREQUENCY == 0:
            outputs = self.actor.outputs(observation)
            # sigmoid(x) = (1 + tanh(x / 2)) / 2: beyond 2 the tanh passes less than 7 % of a gradient.
            flat = F.relu((outputs * HALF).abs() - 2).square().mean()
            loss = SATURATION * flat - self.qf1(observation, self.actor.squash(outputs)).mean()
            self.actor_optimizer.zero_grad()
            loss.backward()
            self.actor_optimizer.step()
            with torch.no_grad():
                for net, target in ((self.actor, self.actor_target), (self.qf1, self.qf1_target), (self.qf2, self.qf2_target)):
                    for p, p_target in zip(net.parameters(), target.parameters()):
                        p_target.lerp_(p, TAU)


class Noise:
    """Noise that lasts about five ticks, because at six decisions a second white noise undoes itself. Each episode draws its
    share of it; a fifth of the episodes have none."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.state = rng, np.zeros(3)
        self.reset()

    def reset(self) -> None:
        self.state = self.rng.standard_normal(3)
        self.share = 0.0 if self.rng.random() < 0.2 else self.rng.random()

    def advance(self) -> None:
        self.state = CORRELATION * self.state + np.sqrt(1 - CORRELATION**2) * self.rng.standard_normal(3)

    def start(self) -> np.ndarray:
        """An action before learning: gently forward, the brake on now and then."""
        return np.array([0.0, 0.45, -0.35]) + np.array([0.08, 0.25, 0.4]) * self.state

    def on(self, action: np.ndarray) -> np.ndarray:
        return action + self.share * EXPLORATION * self.state


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--learning-starts", type=int, default=2_000, help="steps of random driving first")
    parser.add_argument("--episodes", type=int, default=25, help="of the judgement")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="agent.safetensors")
    options = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(options.seed)
    rng = np.random.default_rng(options.seed)

    env = gymnasium.make("wad_cosim/Straight-v0", mode="training")
    agent, buffer, noise = TD3(), ReplayBuffer(options.steps), Noise(rng)
    arrived: deque[bool] = deque(maxlen=20)
    returned, begin = 0.0, time.perf_counter()
    observation, _ = env.reset(seed=options.seed)
    for step in range(1, options.steps + 1):
        noise.advance()
        if step <= options.learning_starts:
            action = noise.start()
        else:
            with torch.no_grad():
                action = noise.on(agent.actor(torch.from_numpy(observation)).numpy())
        action = np.clip(action, LOW.numpy(), HIGH.numpy()).astype(np.float32)
        next_observation, reward, terminated, truncated, info = env.step(action)
        returned += float(reward)
        # A dead SUMO says nothing about driving.
        if info.get("end") != "error":
            buffer.add(observation, action, reward, next_observation, terminated, truncated)
        observation = next_observation
        if terminated or truncated:
            arrived.append(info["success"])
            print(
                f"step {step}: {info['end']} after {info['driven']:.0f} m, episodic_return {returned:.0f}, "
                f"arrived in {sum(arrived)} of the last {len(arrived)}, SPS {step / (time.perf_counter() - begin):.0f}",
                flush=True,
            )
            buffer.recent.clear()
            observation, _ = env.reset()
            returned = 0.0
            noise.reset()
        if step > options.learning_starts and step % 2 == 0:
            agent.update(buffer.sample(rng))
    env.close()
    agent.actor.save(options.out, steps=options.steps, updates=agent.updates, seed=options.seed)
    print(f"{options.steps} steps in {time.perf_counter() - begin:.0f} s; wrote {options.out}")

    # The file, judged on the benchmark's routes, each in a SUMO of its own.
    table = wad_cosim.evaluate(
        "tasks",
        options.out,
        detector="outlines",
        condition="training",
        task="straight",
        weather="ClearNoon",
        episodes=options.episodes,
    )
    rows = table if isinstance(table, list) else table.to_dict("records")
    print(f"success in {rows[0]['successes']} of {rows[0]['episodes']} episodes")


if __name__ == "__main__":
    main()
