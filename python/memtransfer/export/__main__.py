"""`python -m memtransfer.export`: data sets of a run's trajectories."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from memtransfer.export import croissant, lerobot, minari, rerun
from memtransfer.export.common import ExportError, Selected
from memtransfer.trajectories import Recording


def main(arguments: list[str] | None = None) -> int:
    parser = _parser()
    args = parser.parse_args(arguments)
    wanted = [
        (write, place)
        for write, place in (
            (lerobot.write, args.lerobot),
            (minari.write, args.minari),
            (rerun.write, args.rrd),
            (croissant.write, args.croissant),
        )
        if place is not None
    ]
    if not wanted:
        parser.error("say what to write: --lerobot, --minari, --rrd or --croissant")
    try:
        selected = _select(args)
        for write, place in wanted:
            print(write(selected, place))
    except (ExportError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _select(args: argparse.Namespace) -> Selected:
    recording = Recording(args.run, args.frame_size)
    for notice in recording.notices:
        print(f"warning: {notice}", file=sys.stderr)
    only = args.only_demonstrations
    selected = Selected(recording, not only, only or args.demonstrations, args.limit)
    if next(selected.trajectories(), None) is None:
        raise ExportError(f"{args.run} has no finished episode; `memtransfer run` goes on with it")
    return selected


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m memtransfer.export",
        description="Write the trajectories of a run as data sets. Views are rendered from the log's poses, "
        "so the run needs no images.",
        epilog="""Examples:
  python -m memtransfer.export runs/quick-grounded --rrd quick.rrd --limit 5
  python -m memtransfer.export runs/quick-grounded --lerobot data/quick --demonstrations
  python -m memtransfer.export runs/quick-grounded --minari memtransfer/quick-v0 --only-demonstrations

Nothing is overwritten. docs/datasets.md says what each format holds.""",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", metavar="RUN", type=Path, help="the run's folder")
    what = parser.add_argument_group("what to write (at least one; each needs the extra of its name)")
    what.add_argument("--lerobot", metavar="DIR", type=Path, help="a LeRobot data set, version 3.0, with videos")
    what.add_argument(
        "--minari",
        metavar="ID",
        help="a Minari data set, for example memtransfer/quick-v0, in the folder that MINARI_DATASETS_PATH names "
        "[default: ~/.minari/datasets]",
    )
    what.add_argument("--rrd", metavar="FILE", type=Path, help="a recording for the Rerun viewer (extra: rerun)")
    what.add_argument(
        "--croissant",
        metavar="DIR",
        type=Path,
        help="tables of poses and actions (CSV) with a Croissant description, without views",
    )
    which = parser.add_argument_group("which trajectories")
    either = which.add_mutually_exclusive_group()
    either.add_argument(
        "--demonstrations",
        action="store_true",
        help="also the expert demonstrations that the run's memories could be built from",
    )
    either.add_argument("--only-demonstrations", action="store_true", help="these alone")
    which.add_argument(
        "--limit", metavar="N", type=_count, help="the first N episodes, and the first N demonstrations"
    )
    which.add_argument(
        "--frame-size",
        metavar="PX|WxH",
        type=_size,
        help="width and height of a view in pixels, the width a multiple of 64 [default: the run's]",
    )
    return parser


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 1")
    return int(text)


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not width.isdecimal() or not (height or width).isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a size: write 448 or 448x336")
    return int(width), int(height or width)


if __name__ == "__main__":
    sys.exit(main())
