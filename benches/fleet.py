#!/usr/bin/env python3
"""What a run of many units costs on many workers, simulated: start-up, workers of unequal speed, workers that are lost, merge.

    python3 benches/fleet.py --episodes 100000000 --workers 1,100,10000

The costs of a start and of an episode are those that benches/units.py measures on the machine at hand. Units are given to the
worker that is free first. A worker is lost at random moments; its unit goes on where it was, after another start. Ends with
the time of merging, which one machine does alone.
"""

import argparse
import heapq
import random


def simulate(options, workers, unit_episodes):
    """Seconds until the last unit is done, and the share of the workers' time in which episodes were executed."""
    chance = random.Random(options.seed)
    speeds = [chance.lognormvariate(0, options.spread) for _ in range(workers)]
    free = [(0.0, worker) for worker in range(workers)]
    heapq.heapify(free)
    left, end, busy = options.episodes, 0.0, 0.0
    while left > 0:
        episodes = min(unit_episodes, left)
        left -= episodes
        at, worker = heapq.heappop(free)
        work = episodes * options.episode_s / speeds[worker]
        busy += work
        took = options.start_s + work
        lost = chance.expovariate(1 / (options.mtbf_h * 3600))
        while lost < took:
            # Another worker takes its place. Finished episodes are kept.
            took += options.start_s + options.replace_s
            lost += chance.expovariate(1 / (options.mtbf_h * 3600))
        end = max(end, at + took)
        heapq.heappush(free, (at + took, worker))
    return end, busy / (workers * end)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=10**8)
    parser.add_argument("--workers", default="1,10,100,1000,10000")
    parser.add_argument("--unit-episodes", default="500,5000,50000")
    parser.add_argument("--start-s", type=float, default=2.0, help="seconds from a worker's start to its first episode")
    parser.add_argument("--episode-s", type=float, default=0.004, help="seconds of a worker for an episode")
    parser.add_argument("--merge-s", type=float, default=2e-5, help="seconds of merging for an episode")
    parser.add_argument("--mtbf-h", type=float, default=24, help="hours until a worker is lost, on average")
    parser.add_argument("--replace-s", type=float, default=60, help="seconds until another takes its place")
    parser.add_argument("--spread", type=float, default=0.15, help="standard deviation of the logarithm of speeds")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    print("| workers | episodes of a unit | units | time | efficiency | merge |\n|---|---|---|---|---|---|")
    for workers in map(int, options.workers.split(",")):
        for unit_episodes in map(int, options.unit_episodes.split(",")):
            units = -(-options.episodes // unit_episodes)
            end, efficiency = simulate(options, workers, unit_episodes)
            merge = options.episodes * options.merge_s
            print(
                f"| {workers:,} | {unit_episodes:,} | {units:,} | {end / 3600:,.2f} h "
                f"| {100 * efficiency:.0f} % | {merge / 3600:.2f} h |"
            )


if __name__ == "__main__":
    main()
