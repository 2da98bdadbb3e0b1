#!/usr/bin/env python3
"""What an open live page costs a run of 64 lanes: pairs of runs, without and with the page, in alternating order.

    PATH=target/release:$PATH python3 benches/live_page.py --pairs 10

Chromium runs before each run begins, with an empty page. With the live page, `memtransfer view --serve` starts when the first
episode is in the log, and the page stays open until the run ends. Prints the wall time of each run, and the processor time
that the browser and the server took meanwhile, as a share of all cores; at the end the median of the ratios with and without
the page, and how far they spread.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

TICKS = os.sysconf("SC_CLK_TCK")


def tree(root):
    """The process `root` and its descendants."""
    found, todo = [], [root]
    while todo:
        pid = todo.pop()
        try:
            children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        except FileNotFoundError:
            continue
        found.append(pid)
        todo += map(int, children)
    return found


def cpu_s(root):
    total = 0
    for pid in tree(root):
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        except FileNotFoundError:
            continue
        # User and system time, its own and of children that it has waited for.
        total += sum(map(int, fields[11:15]))
    return total / TICKS


def quartiles(values):
    """The lower and the upper quartile."""
    if len(values) == 1:
        return values[0], values[0]
    low, _, high = statistics.quantiles(values, n=4, method="inclusive")
    return low, high


class Browser:
    def __init__(self, program, profile):
        command = [program, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"]
        command += ["--disable-dev-shm-usage", "--remote-debugging-port=0", f"--user-data-dir={profile}", "about:blank"]
        self.child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        port = Path(profile) / "DevToolsActivePort"
        while not (port.exists() and port.read_text().count("\n")):
            time.sleep(0.1)
        self.address = f"http://127.0.0.1:{port.read_text().split()[0]}/json"

    def open(self, url):
        request = urllib.request.Request(f"{self.address}/new?{url}", method="PUT")
        return json.load(urllib.request.urlopen(request))["id"]

    def close(self, page):
        urllib.request.urlopen(f"{self.address}/close/{page}").read()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--suite", default="rq2")
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--program", default="memtransfer")
    parser.add_argument("--browser", default=shutil.which("chromium") or "google-chrome")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="live-") as folder:
        folder = Path(folder)
        browser = Browser(options.browser, folder / "profile")

        def run(name, has_page):
            out = folder / name
            command = [options.program, "run", "--suite", options.suite, "--policy", "grounded", "--lanes", "64"]
            before, start = cpu_s(browser.child.pid), time.monotonic()
            running = subprocess.Popen(
                [*command, "--out", out, "--quiet"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
            log, server, page = out / "episodes.jsonl", None, None
            while has_page and not (log.exists() and log.stat().st_size):
                time.sleep(0.02)
            if has_page:
                view = [options.program, "view", out, "--serve"]
                server = subprocess.Popen(view, stdout=subprocess.PIPE, text=True)
                page = browser.open(server.stdout.readline().strip())
            assert running.wait() == 0
            wall = time.monotonic() - start
            used = cpu_s(browser.child.pid) - before + (cpu_s(server.pid) if server else 0)
            if server:
                browser.close(page)
                server.kill()
                server.wait()
            shutil.rmtree(out)
            return wall, used / (wall * os.cpu_count())

        try:
            run("warm", False)
            pairs = []
            print("| pair | without, s | with, s | ratio | share of all cores without | with |\n|---|---|---|---|---|---|")
            for number in range(options.pairs):
                order = [False, True] if number % 2 == 0 else [True, False]
                walls = {has_page: run(f"run-{number}-{has_page}", has_page) for has_page in order}
                (without, idle), (with_page, share) = walls[False], walls[True]
                ratio = with_page / without
                pairs.append((ratio, share - idle))
                shares = f"{100 * idle:.1f} % | {100 * share:.1f} %"
                print(f"| {number + 1} | {without:.2f} | {with_page:.2f} | {ratio:.3f} | {shares} |", flush=True)
            ratios, added = zip(*pairs)
            low, high = quartiles(ratios)
            print(f"\nmedian ratio {statistics.median(ratios):.3f} of {len(pairs)} pairs; quartiles {low:.3f} and {high:.3f}, "
                  f"lowest {min(ratios):.3f}, highest {max(ratios):.3f}")
            print(f"median share of all cores that the page added: {100 * statistics.median(added):.1f} %")
        finally:
            browser.child.kill()
            browser.child.wait()


if __name__ == "__main__":
    main()
