"""A random agent in the Gymnasium environment: how often does it succeed, and how many steps a second is that?

    python gym_random.py --episodes 20

Needs `pip install 'memtransfer[gym]'`.
"""

import argparse
import time

import gymnasium


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--episodes", type=int, default=20, metavar="N")
    parser.add_argument("--frame-size", type=int, default=128, metavar="PIXELS")
    arguments = parser.parse_args()
    env = gymnasium.make("memtransfer.gym:MemTransfer-v0", frame_size=arguments.frame_size)
    env.action_space.seed(1)
    steps = successes = 0
    began = time.perf_counter()
    for episode in range(arguments.episodes):
        _, info = env.reset(seed=episode)
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(env.action_space.sample())
            steps += 1
            over = terminated or truncated
        successes += info["is_success"]
    seconds = time.perf_counter() - began
    print(f"{successes} of {arguments.episodes} episodes succeeded, {steps / seconds:.0f} steps/s")


if __name__ == "__main__":
    main()
