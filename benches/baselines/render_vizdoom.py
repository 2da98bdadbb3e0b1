"""ViZDoom: how many views per second it renders without a window into arrays.

    {"do": "start", "width": 512, "height": 384}    ->    {"version": ..., "pixels": ...}
    {"do": "time", "views": 200}                    ->    {"seconds": ..., "views": ...}

The agent turns and walks through the rooms of the scenario "my way home"; every step is one tick of the game, and
its image is read as an RGB array.
"""

import os
import tempfile
import time

import vizdoom

from _serve import serve

GAME = vizdoom.DoomGame()

# ViZDoom writes its settings to a file: keep it out of the working folder.
SCRATCH = tempfile.TemporaryDirectory(prefix="vizdoom-")


def start(width, height):
    GAME.load_config(os.path.join(vizdoom.scenarios_path, "my_way_home.cfg"))
    GAME.set_doom_config_path(os.path.join(SCRATCH.name, "vizdoom.ini"))
    GAME.set_window_visible(False)
    GAME.set_mode(vizdoom.Mode.PLAYER)
    GAME.set_screen_format(vizdoom.ScreenFormat.RGB24)
    GAME.set_screen_resolution(getattr(vizdoom.ScreenResolution, f"RES_{width}X{height}"))
    GAME.set_render_hud(False)
    GAME.set_seed(1)
    GAME.init()
    GAME.new_episode()
    return {
        "version": vizdoom.__version__,
        "pixels": GAME.get_screen_width() * GAME.get_screen_height(),
    }


def timed(views):
    count, images = len(GAME.get_available_buttons()), 0
    began = time.perf_counter()
    for view in range(views):
        if GAME.is_episode_finished():
            GAME.new_episode()
        # Turn left, or move ahead.
        pressed = [1 if button == (0 if view % 3 else count - 1) else 0 for button in range(count)]
        GAME.make_action(pressed)
        state = GAME.get_state()
        if state is not None:
            images += state.screen_buffer is not None
    return {"seconds": time.perf_counter() - began, "views": images}


serve(start=start, time=timed)
