"""Recordings for the Rerun viewer (`.rrd`), written by Rerun's SDK."""

from __future__ import annotations

import io
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from memtransfer.codes import Feedback
from memtransfer.export.common import Selected, library, new, progress, refuse_existing
from memtransfer.trajectories import Trajectory

TIMELINE = "step"

_FLOOR, _SHELF, _CLOSED = (235, 235, 235), (120, 120, 120), (200, 40, 40)
_PATH, _REFERENCE, _TARGET, _AGENT = (30, 100, 220), (150, 190, 150), (220, 150, 0), (210, 30, 90)
_NORTH_EAST_SOUTH_WEST = np.array([(0, -1), (1, 0), (0, 1), (-1, 0)])


def write(selected: Selected, file: Path) -> str:
    """Writes the recording into a new file. Returns what was written, in words."""
    refuse_existing(file)
    rr = library("rerun", "rerun")
    blueprint = library("rerun.blueprint", "rerun")
    pillow = library("PIL.Image", "rerun")
    tabs = []
    steps = 0
    with new(file) as partial:
        with rr.RecordingStream("memtransfer", recording_id=file.stem, send_properties=False) as stream:
            # Steps are the only time line: when the file was written is none.
            stream.set_log_time_enabled(False)
            stream.set_log_tick_enabled(False)
            stream.save(partial)
            for trajectory in progress("Rerun", selected.trajectories()):
                _log(rr, pillow, stream, selected, trajectory)
                tabs.append(_tab(rr, blueprint, trajectory))
                steps += len(trajectory.actions)
            stream.send_blueprint(blueprint.Blueprint(blueprint.Tabs(*tabs), collapse_panels=True))
    return f"{file}: {len(tabs)} trajectories, {steps} steps"


def entity(rr: Any, trajectory: Trajectory, *parts: str) -> str:
    """The path of an entity of a trajectory."""
    path: str = rr.new_entity_path([*trajectory.id.split("/"), *parts])
    return path


def _tab(rr: Any, blueprint: Any, trajectory: Trajectory) -> Any:
    def at(part: str) -> str:
        return entity(rr, trajectory, part)

    return blueprint.Horizontal(
        blueprint.Spatial2DView(origin=at("camera"), name="Camera"),
        blueprint.Spatial2DView(origin=at("map"), name="Map"),
        blueprint.Vertical(
            blueprint.TextLogView(origin=at("events"), name="Events"),
            blueprint.TimeSeriesView(origin=at("pose"), name="Pose"),
        ),
        name=trajectory.id,
    )


def _log(rr: Any, pillow: Any, stream: Any, selected: Selected, trajectory: Trajectory) -> None:
    def at(*parts: str) -> str:
        return entity(rr, trajectory, *parts)

    def by_step(path: str, columns: Any) -> None:
        steps = rr.TimeColumn(TIMELINE, sequence=range(len(trajectory.poses)))
        stream.send_columns(path, indexes=[steps], columns=columns)

    views = [_jpeg(pillow, view) for view in selected.recording.views(trajectory)]
    by_step(at("camera"), rr.EncodedImage.columns(blob=views, media_type=["image/jpeg"] * len(views)))

    floor = selected.recording.floor(trajectory.variant)
    rows = len(floor)

    def centres(cells: Any) -> NDArray[np.float64]:
        """Where cells are on the map, whose row 0 is in the north."""
        column_row = np.array(cells, np.float64).reshape(-1, 2)
        return column_row * (1, -1) + (0.5, rows - 0.5)

    drawn = np.where(floor[..., None], _FLOOR, _SHELF).astype(np.uint8)
    for column, row in trajectory.closed:
        drawn[row, column] = _CLOSED
    stream.log(at("map", "floor"), rr.Image(drawn[::-1]), static=True)
    stream.log(
        at("map", "reference"),
        rr.LineStrips2D([centres(trajectory.reference)], colors=[_REFERENCE], radii=0.15),
        static=True,
    )
    targets = rr.Points2D(
        centres([cell for _, _, cell in trajectory.targets]),
        labels=[f"{letter}: {name}" for letter, name, _ in trajectory.targets],
        colors=[_TARGET],
        radii=0.3,
    )
    stream.log(at("map", "targets"), targets, static=True)
    path = centres(trajectory.poses[:, :2])
    vectors = 0.8 * _NORTH_EAST_SOUTH_WEST[trajectory.poses[:, 2]]
    stream.log(at("map", "agent"), rr.Arrows2D.from_fields(colors=[_AGENT], radii=[0.2]), static=True)
    by_step(at("map", "agent"), rr.Arrows2D.columns(origins=path, vectors=vectors))
    for step in range(len(path)):
        stream.set_time(TIMELINE, sequence=step)
        stream.log(at("map", "path"), rr.LineStrips2D([path[: step + 1]], colors=[_PATH], radii=0.1))

    if selected.control:
        stream.set_time(TIMELINE, sequence=0)
        stream.log(at("events"), rr.TextLog(selected.control.strip(), level="WARN"))
    for name, values in zip(("column", "row", "heading"), trajectory.poses.T):
        by_step(at("pose", name), rr.Scalars.columns(scalars=values.astype(np.float64)))
    for step, level, text in events(trajectory, selected.recording.policy_label):
        stream.set_time(TIMELINE, sequence=step)
        stream.log(at("events"), rr.TextLog(text, level=level))


def events(trajectory: Trajectory, policy: str) -> list[tuple[int, str, str]]:
    """Who acted, the policy or the expert of a demonstration, and what happened, as step, level and words."""
    column, row, _ = trajectory.poses[0].tolist()
    start = f"{trajectory.instruction} From column {column}, row {row}, facing {trajectory.headings[0].words}."
    actor = f"Policy: {policy}." if trajectory.record else "Expert demonstration."
    found = [(0, "INFO", actor), (0, "INFO", start)]
    record = trajectory.record or {}
    sources, distances = ((record.get(column) or "").split() for column in ("retrieved", "distances"))
    for step, (source, distance) in enumerate(zip_longest(sources, distances, fillvalue="-")):
        told = "" if distance == "-" else f", distance {distance}"
        found.append((step, "DEBUG", f"memory supplied {source}{told}"))
    for step, (action, feedback) in enumerate(zip(trajectory.actions, trajectory.feedback[1:]), 1):
        if action is None:
            found.append((step, "WARN", "no action could be read"))
        elif feedback is Feedback.BLOCKED:
            found.append((step, "WARN", f"{action.words}: blocked"))
        else:
            found.append((step, "TRACE", action.words))
    for number, step in enumerate(trajectory.sub_goals, 1):
        found.append((step, "INFO", f"sub-goal {number} of {trajectory.required} completed"))
    conflict = record.get("conflict_at")
    if conflict is not None:
        found.append((conflict, "WARN", "tried to enter the closed passage"))
    if trajectory.success:
        found.append((len(trajectory.actions), "INFO", "task complete"))
    if trajectory.failure is not None:
        kind, step = trajectory.failure
        found.append((step, "ERROR", f"failed: {kind}"))
    return sorted(found, key=lambda event: event[0])


def _jpeg(pillow: Any, view: NDArray[np.uint8]) -> bytes:
    file = io.BytesIO()
    pillow.fromarray(view).save(file, "JPEG", quality=90)
    return file.getvalue()
