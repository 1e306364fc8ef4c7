"""PPO of RLlib learns to drive on two env runners, each with two environments that step together.

    pip install "ray[rllib]==2.60.*" torch
    python rllib_ppo.py

RLlib takes the native vector environment by its vector entry point. It pins Gymnasium 1.2.2, with which wad_cosim works too.
"""

import argparse

import gymnasium
import ray
from ray.rllib.algorithms.ppo import PPOConfig

parser = argparse.ArgumentParser()
parser.add_argument("--iterations", type=int, default=50)
parser.add_argument("--batch", type=int, default=2_000, help="steps of an iteration")
parser.add_argument("--runners", type=int, default=2)
parser.add_argument("--environments", type=int, default=2, help="of each runner")
parser.add_argument("--seed", type=int, default=1)
options = parser.parse_args()

# A cluster of its own: without an address Ray joins one that happens to run on this machine.
ray.init(address="local", num_cpus=options.runners, include_dashboard=False, log_to_driver=False)
config = (
    PPOConfig()
    # The part before the colon is imported by each runner: that registers the ids.
    .environment("wad_cosim:wad_cosim/Straight-v0", env_config={"action": "pedal", "mode": "training"})
    .env_runners(
        num_env_runners=options.runners,
        num_envs_per_env_runner=options.environments,
        gym_env_vectorize_mode=gymnasium.VectorizeMode.VECTOR_ENTRY_POINT,
        num_cpus_per_env_runner=0.5,
        # A runner starts its SUMOs first, and a busy machine takes its time.
        sample_timeout_s=600,
    )
    .training(gamma=0.98, lr=1e-3, train_batch_size_per_learner=options.batch, minibatch_size=250, num_epochs=10)
    .debugging(seed=options.seed)
)
algorithm = config.build_algo()
for iteration in range(1, options.iterations + 1):
    result = algorithm.train()
    found = result["env_runners"]
    print(
        f"iteration {iteration}: {found['num_env_steps_sampled_lifetime']:.0f} steps, "
        f"episodic_return {found.get('episode_return_mean', float('nan')):.1f}, "
        f"episodic_length {found.get('episode_len_mean', float('nan')):.0f}, "
        f"loss {result['learners']['default_policy']['total_loss']:.3f}, "
        f"{found.get('num_episodes_lifetime', 0):.0f} episodes",
        flush=True,
    )
algorithm.stop()
ray.shutdown()
