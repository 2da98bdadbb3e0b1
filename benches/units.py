#!/usr/bin/env python3
"""What it costs to execute a run in units: the plan's units in processes of their own, some of them killed, beside one run.

    python3 benches/units.py --suite paper --units 40 --workers 1,2

executes the run once to fill the cache of embeddings, once more as the reference, and then, for each number of workers, all
units in random order, in as many processes at a time. Every third process is killed at a random moment with SIGKILL, and its
unit given again. The views that units share are removed before, so the units render them. It checks that the merged log has
the lines of the single run, and prints wall and processor time of each. Processor time includes killed processes.

    python3 benches/units.py --suite paper --units 40 --workers 2 --cold

begins the single run and the units with a cache folder each that has no embeddings, so both compute all of them.
"""

import argparse
import ctypes
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36


def cpu_s():
    """Processor time of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def reap_orphans(ours):
    """Waits for the children of processes that were killed, so that their time counts."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
        orphans = [int(pid) for pid in children if int(pid) not in ours]
        if not orphans:
            return
        for pid in orphans:
            try:
                os.waitpid(pid, os.WNOHANG)
            except ChildProcessError:
                pass
        time.sleep(0.01)
    sys.exit("processes of a killed worker have not ended")


def measured(action):
    cpu, wall = cpu_s(), time.monotonic()
    action()
    reap_orphans(set())
    return time.monotonic() - wall, cpu_s() - cpu


def without_embeddings(cache, fresh):
    """Makes a cache folder `fresh` with all that `cache` has but embeddings and views. Programs use it from now on."""
    fresh.mkdir()
    for entry in cache.iterdir():
        if entry.name not in ("embeddings", "views"):
            (fresh / entry.name).symlink_to(entry)
    os.environ["MEMTRANSFER_CACHE"] = str(fresh)


def lines(run):
    return sorted((run / "episodes.jsonl").read_bytes().splitlines())


class Units:
    def __init__(self, program, plan, out, units, options):
        self.program, self.plan, self.out, self.units = program, plan, out, units
        self.kill_every, self.random = options.kill_every, random.Random(options.seed)
        self.lock = threading.Lock()
        self.typical_s = 3.0

    def work(self, unit):
        return [self.program, "work", "--plan", self.plan, "--unit", str(unit), "--out", self.out, "--quiet"]

    def execute(self, position, unit, fraction):
        if self.kill_every and position % self.kill_every == self.kill_every - 1:
            child = subprocess.Popen(self.work(unit), stdout=subprocess.DEVNULL)
            try:
                child.wait(fraction * self.typical_s)
            except subprocess.TimeoutExpired:
                child.send_signal(signal.SIGKILL)
                child.wait()
        start = time.monotonic()
        subprocess.run(self.work(unit), check=True, stdout=subprocess.DEVNULL)
        with self.lock:
            self.typical_s = 0.8 * self.typical_s + 0.2 * (time.monotonic() - start)

    def execute_all(self, workers):
        order = list(range(self.units))
        self.random.shuffle(order)
        with ThreadPoolExecutor(workers) as pool:
            jobs = [
                pool.submit(self.execute, position, unit, self.random.random())
                for position, unit in enumerate(order)
            ]
            for job in jobs:
                job.result()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", default="memtransfer", help="the program (default: from the PATH)")
    parser.add_argument("--suite", default="paper")
    parser.add_argument("--units", type=int, default=40)
    parser.add_argument("--workers", default="1,2", help="workers at a time, one measurement each")
    parser.add_argument("--kill-every", type=int, default=3, help="kill every Nth process; 0 kills none")
    parser.add_argument("--seed", type=int, default=1)
    caches = parser.add_mutually_exclusive_group()
    caches.add_argument("--no-warm-up", action="store_true", help="embeddings are in the cache already")
    caches.add_argument("--cold", action="store_true", help="begin without embeddings")
    parser.add_argument("flags", nargs="*", help="further flags of the run, after --")
    options = parser.parse_args()
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    cache = Path(os.environ.get("MEMTRANSFER_CACHE") or os.path.expanduser("~/.cache/memtransfer"))
    with tempfile.TemporaryDirectory(prefix="units-") as folder:
        folder = Path(folder)
        settings = ["--suite", options.suite, "--policy", "grounded", *options.flags]

        def single(name):
            command = [options.program, "run", *settings, "--out", folder / name, "--quiet"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

        if options.cold:
            without_embeddings(cache, folder / "cache")
        elif not options.no_warm_up:
            single("warm")
        wall, cpu = measured(lambda: single("single"))
        expected = lines(folder / "single")
        size = -(-len(expected) // options.units)
        plan = folder / "plan.json"
        subprocess.run(
            [options.program, "plan", *settings, "--out", plan, "--unit-episodes", str(size), "--quiet"], check=True
        )
        units = -(-len(expected) // size)
        print(f"{len(expected)} episodes, {units} units of {size}, kill every {options.kill_every or 'none'}")
        print("| | wall | processor | wall, ratio | processor, ratio |\n|---|---|---|---|---|")
        print(f"| one run | {wall:.1f} s | {cpu:.1f} s | | |", flush=True)
        for workers in map(int, options.workers.split(",")):
            if options.cold:
                without_embeddings(cache, folder / f"cache-{workers}")
            else:
                shutil.rmtree(cache / "views", ignore_errors=True)
            out, merged = folder / f"units-{workers}", folder / f"merged-{workers}"
            work = Units(options.program, plan, out, units, options)

            def execute(work=work, workers=workers, out=out, merged=merged):
                work.execute_all(workers)
                subprocess.run(
                    [options.program, "merge", "--plan", plan, out, "--out", merged],
                    check=True,
                    stderr=subprocess.DEVNULL,
                )

            took, used = measured(execute)
            if lines(merged) != expected:
                sys.exit("the merged log differs from that of the single run")
            print(
                f"| units, {workers} at a time, and merge | {took:.1f} s | {used:.1f} s "
                f"| {took / wall:.2f} | {used / cpu:.2f} |",
                flush=True,
            )
            shutil.rmtree(out)


if __name__ == "__main__":
    main()
