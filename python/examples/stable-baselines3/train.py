"""Trains PPO of Stable-Baselines3 on one case for some thousand steps, and tests what it has learnt.

    pip install memtransfer-*.whl -r requirements.txt
    python train.py --steps 4096

Some thousand steps show that everything fits together, no more: the reward is sparse, so an agent that learns
from nothing needs a curriculum, or demonstrations. The instruction is left out, because it is always the same here.
"""

import argparse
from typing import Any

import gymnasium
from gymnasium.wrappers import FilterObservation
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy


def make(case: str, max_steps: int) -> gymnasium.Env[Any, Any]:
    env = gymnasium.make("memtransfer.gym:MemTransfer-v0", case=case, frame_size=64, max_steps=max_steps)
    return FilterObservation(env, ["pixels", "pose", "feedback"])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--case", default="t02-04")
    parser.add_argument("--steps", type=int, default=4096, metavar="N")
    parser.add_argument("--max-steps", type=int, default=64, metavar="N")
    arguments = parser.parse_args()
    settings = {"case": arguments.case, "max_steps": arguments.max_steps}
    envs = make_vec_env(make, n_envs=8, seed=1, env_kwargs=settings)
    agent = PPO("MultiInputPolicy", envs, n_steps=128, batch_size=256, ent_coef=0.01, seed=1, verbose=1)
    agent.learn(arguments.steps)
    reward, _ = evaluate_policy(agent, envs, n_eval_episodes=20, deterministic=False)
    print(f"success rate {reward:.2f} after {agent.num_timesteps} steps")


if __name__ == "__main__":
    main()
