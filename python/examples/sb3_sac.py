"""SAC of Stable-Baselines3 learns to drive 400 m of road, and is judged on routes that it did not see.

    pip install stable-baselines3
    python sb3_sac.py

It reads 15 numbers of each tick and steers with two: the wheel and a pedal.
"""

import argparse
import time

import gymnasium
import torch
from stable_baselines3 import SAC

import wad_cosim  # noqa: F401  registers the ids
from wad_cosim.sb3 import DrivingVecEnv

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=15_000)
parser.add_argument("--environments", type=int, default=1)
parser.add_argument("--episodes", type=int, default=25)
parser.add_argument("--seed", type=int, default=1)
options = parser.parse_args()

torch.set_num_threads(1)
begin = time.perf_counter()
envs = DrivingVecEnv("wad_cosim/Straight-v0", options.environments, action="pedal", mode="training")
model = SAC(
    "MlpPolicy",
    envs,
    learning_rate=1e-3,
    gamma=0.98,
    batch_size=128,
    learning_starts=500,
    train_freq=1,
    gradient_steps=1,
    ent_coef="auto_0.1",
    policy_kwargs={"net_arch": [64, 64]},
    seed=options.seed,
)
model.learn(options.steps, log_interval=None)
envs.close()
print(f"{options.steps} steps in {time.perf_counter() - begin:.0f} s")

# The benchmark's own routes, each with a SUMO of its own.
env = gymnasium.make("wad_cosim/Straight-v0", condition="training", action="pedal")
successes = 0
for episode in range(options.episodes):
    observation, _ = env.reset(seed=1000 + episode, options={"route": episode % 25})
    over = False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    successes += info["success"]
env.close()
print(f"success in {successes} of {options.episodes} episodes, {100 * successes / options.episodes:.0f} %")
