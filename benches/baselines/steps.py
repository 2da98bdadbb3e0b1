"""Steps a second of our Gymnasium environment, of MiniWorld and of ViZDoom, in turns in one process.

    PYTHONPATH=python python benches/baselines/steps.py

A step is an action, the dynamics, and the view as an RGB array: 448 x 448 pixels, in ViZDoom 512 x 384, where it is not
anti-aliased. Needs our package and those of `requirements.txt`. Prints the median rate of the rounds, and its ratio to ours.
"""

import argparse
import os
import statistics
import tempfile
import time

import pyglet

pyglet.options["headless"] = True
import gymnasium  # noqa: E402
import miniworld  # noqa: E402, F401
import vizdoom  # noqa: E402

LANES = 64


def gymnasium_steps(env):
    env.reset(seed=1)
    env.action_space.seed(1)

    def steps(count):
        for _ in range(count):
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                env.reset()
        return count

    return steps


def vector_steps(envs):
    envs.reset(seed=1)
    envs.action_space.seed(1)

    def steps(count):
        for _ in range(count // LANES):
            envs.step(envs.action_space.sample())
        return count // LANES * LANES

    return steps


def vizdoom_game(folder):
    game = vizdoom.DoomGame()
    game.load_config(os.path.join(vizdoom.scenarios_path, "my_way_home.cfg"))
    game.set_doom_config_path(os.path.join(folder, "vizdoom.ini"))
    game.set_window_visible(False)
    game.set_screen_format(vizdoom.ScreenFormat.RGB24)
    game.set_screen_resolution(vizdoom.ScreenResolution.RES_512X384)
    game.set_seed(1)
    game.init()
    return game


def vizdoom_steps(game):
    buttons = len(game.get_available_buttons())

    def steps(count):
        for step in range(count):
            if game.is_episode_finished():
                game.new_episode()
            game.make_action([int(button == step % buttons) for button in range(buttons)])
            state = game.get_state()
            assert state is None or state.screen_buffer is not None
        return count

    return steps


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5, metavar="N")
    parser.add_argument("--steps", type=int, default=640, metavar="N")
    arguments = parser.parse_args()
    name, bare = "memtransfer.gym:MemTransfer-v0", {"anti_aliasing": False}
    with tempfile.TemporaryDirectory(prefix="vizdoom-") as folder:
        game = vizdoom_game(folder)
        measured = {
            "ours": gymnasium_steps(gymnasium.make(name)),
            f"ours, {LANES} lanes": vector_steps(gymnasium.make_vec(name, LANES)),
            "ours, not anti-aliased": gymnasium_steps(gymnasium.make(name, **bare)),
            f"ours, {LANES} lanes, not anti-aliased": vector_steps(gymnasium.make_vec(name, LANES, **bare)),
            "MiniWorld": gymnasium_steps(
                gymnasium.make("MiniWorld-FourRooms-v0", obs_width=448, obs_height=448)
            ),
            "ViZDoom": vizdoom_steps(game),
        }
        rates = {name: [] for name in measured}
        for round_number in range(arguments.rounds + 1):
            for name, steps in measured.items():
                began = time.perf_counter()
                taken = steps(arguments.steps)
                # The first round warms up.
                if round_number > 0:
                    rates[name].append(taken / (time.perf_counter() - began))
        game.close()
    ours = statistics.median(rates["ours"])
    for name, rate in rates.items():
        rate = statistics.median(rate)
        print(f"{name:34} {rate:8.0f} steps/s {rate / ours:6.2f}")


if __name__ == "__main__":
    main()
