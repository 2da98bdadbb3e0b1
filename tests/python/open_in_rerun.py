"""Opens a file in the viewer of Rerun, without a window, and waits until it draws the views whose paths end as told.

    python open_in_rerun.py FILE PATH [PATH ...]

It fails when a view is missing or empty, or the viewer reports a problem.
"""

import io
import socket
import sys
import time
from pathlib import Path

import numpy as np
import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

file, *wanted = sys.argv[1:]
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
program = str(Path(rerun_cli.__file__).with_name("rerun"))


def is_drawn(viewer, view):
    """Whether the view is there and no empty surface; one of a tab in the background is not there."""
    try:
        picture = Image.open(io.BytesIO(viewer.take_screenshot(view.view_id))).convert("RGB")
    except ConnectionError:
        return False
    return len(np.unique(np.asarray(picture).reshape(-1, 3), axis=0)) > 16


with ViewerClient.spawn(headless=True, port=port, executable_path=program) as viewer:
    viewer.open(Path(file).absolute().as_uri())
    deadline = time.monotonic() + 60
    while wanted:
        views = viewer.get_state().views
        drawn = [view.origin for view in views if view.origin.endswith(tuple(wanted)) and is_drawn(viewer, view)]
        wanted = [path for path in wanted if not any(origin.endswith(path) for origin in drawn)]
        assert time.monotonic() < deadline, f"not drawn: {wanted}; the viewer has {views}"
    assert not any(view.reports for view in views), views
    problems = [one for one in viewer.get_logs() if one.level in ("WARN", "ERROR")]
    # Pictures are drawn on the processor here, views of other tabs are not drawn, and the start page has no network.
    expected = ("Software rasterizer", "not found for screenshot", "Failed to load examples")
    assert all(any(words in one.message for words in expected) for one in problems), problems
