"""MiniWorld: how many views per second it renders off screen into arrays.

    {"do": "start", "width": 448, "height": 448}    ->    {"version": ..., "renderer": ..., "samples": ...}
    {"do": "time", "views": 200}                    ->    {"seconds": ..., "views": ...}

The world is its four rooms. Each view is from another place, as ours are; neither physics nor rewards are computed.
"""

import time

import pyglet

pyglet.options["headless"] = True
import gymnasium  # noqa: E402
import miniworld  # noqa: E402
import numpy  # noqa: E402

from _serve import serve  # noqa: E402

WORLD = {}


def start(width, height):
    from importlib.metadata import version

    from pyglet import gl

    env = gymnasium.make("MiniWorld-FourRooms-v0", obs_width=width, obs_height=height)
    env.reset(seed=1)
    WORLD["env"] = env.unwrapped
    WORLD["random"] = numpy.random.default_rng(1)
    samples = gl.GLint()
    env.unwrapped.obs_fb.bind()
    gl.glGetIntegerv(gl.GL_SAMPLES, samples)
    return {
        "version": version("miniworld"),
        "renderer": gl.gl_info.get_renderer(),
        "samples": samples.value,
        "shape": env.unwrapped.render_obs().shape,
    }


def timed(views):
    env, random = WORLD["env"], WORLD["random"]
    rooms = env.rooms
    began = time.perf_counter()
    for _ in range(views):
        room = rooms[random.integers(len(rooms))]
        x = random.uniform(room.min_x + 1, room.max_x - 1)
        z = random.uniform(room.min_z + 1, room.max_z - 1)
        env.agent.pos = numpy.array([x, 0.0, z])
        env.agent.dir = random.uniform(0, 2 * numpy.pi)
        env.render_obs()
    return {"seconds": time.perf_counter() - began, "views": views}


serve(start=start, time=timed)
