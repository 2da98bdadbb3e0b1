"""Computes what `memtransfer score` prints from the specification alone, with NumPy and SciPy, for runs that are drawn.

    python compare_scores.py MEMTRANSFER MANIFEST FOLDER

MEMTRANSFER is the program, MANIFEST the manifest of any run; the runs are written into FOLDER.
"""

import functools
import json
import math
import pathlib
import subprocess
import sys

import numpy as np
from blake3 import blake3
from scipy import stats
from statsmodels.stats.descriptivestats import sign_test
from statsmodels.stats.multitest import multipletests

PAIRS = 200
SEED = 20_260_101
CASES = [f"t{task:02}-{number:02}" for task in range(1, 11) for number in range(1, 5)]


def seed_of(key, run_seed):
    """The seed of the episode `key` in a run with the seed `run_seed`."""
    digest = blake3(b"memtransfer episode seed v1\0" + run_seed.to_bytes(8, "little") + key.encode()).digest()
    return int.from_bytes(digest[:8], "little")


def draw_condition(random, condition, cases, repetitions, kept, run_seed):
    """The records of a condition: each case has its own success rate, and some episodes are missing."""
    memory, start, route, demonstrations, *variation = condition.split("/")
    records = []
    for case in cases:
        rate = random.beta(random.choice([0.3, 3.0]), random.choice([0.3, 3.0]))
        for run in range(1, repetitions + 1):
            if random.random() > kept:
                continue
            success, reference = bool(random.random() < rate), int(random.integers(5, 40))
            steps = int(random.integers(4, 80)) if success else 100
            record = {
                "key": f"{condition}/run{run}/{case}",
                "memory": memory,
                "start": start,
                "route": route,
                "demonstrations": demonstrations,
                "run": run,
                "case": case,
                "task": int(case[1:3]),
                "seed": seed_of(f"{condition}/run{run}/{case}", run_seed),
                "ending": "complete" if success else "out-of-steps",
                "steps": steps,
                "reference": reference,
                "actions": "f" * steps,
                "sub_goals": [steps] if success else [],
                "required": 1,
                "world": {},
            }
            if variation:
                record["window"] = int(variation[0][1:])
            if route == "blocked":
                if random.random() < 0.6:
                    record["conflict_at"] = 1
            records.append(record)
    return records


def write_run(folder, manifest, records):
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text(json.dumps({**manifest, "episodes": len(records)}))
    (folder / "episodes.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))


def success(record):
    return 100.0 * (record["ending"] == "complete")


def path_length(record):
    return success(record) / 100.0 * record["reference"] / max(record["steps"], record["reference"])


def tried(record):
    return 100.0 * ("conflict_at" in record) if record["route"] == "blocked" else None


def recovered(record):
    return success(record) if "conflict_at" in record else None


# The interval of section 7: `values` are the cases' means, `weights` their weights, and a case lies between `low` and `high`.


def interval(values, weights, low, high):
    values, shares = np.array(values), np.array(weights) / np.sum(weights)
    if len(values) < 2:
        return None
    figure, n = np.sum(shares * values), 1 / np.sum(shares**2)
    return interval_from(figure, np.sum(shares**2 * (values - figure) ** 2), n, low, high)


def interval_from(figure, variance, n, low, high):
    middle = (n * figure + low + high) / (n + 2)
    squares = n**2 * variance + n * (figure - middle) ** 2 + (low - middle) ** 2 + (high - middle) ** 2
    half = stats.t.ppf(0.975, n + 1) * math.sqrt(squares / ((n + 1) * (n + 2)))
    return {"low": min(max(middle - half, low), figure), "high": max(min(middle + half, high), figure)}


def near(found, expected, what):
    """Checks that two documents are the same, numbers to 1e-9."""
    if isinstance(expected, dict):
        for key, value in expected.items():
            near(found[key], value, f"{what}, {key}")
    elif expected is None or isinstance(expected, (str, int)):
        assert found == expected, f"{what}: {found}, not {expected}"
    else:
        assert found is not None and abs(found - expected) < 1e-9, f"{what}: {found}, not {expected}"


def comparison(first, second):
    """What `score` says about two conditions, from their records."""
    others = {(record["case"], record["run"]): record for record in second}
    pairs = [(record, others[record["case"], record["run"]]) for record in first if (record["case"], record["run"]) in others]
    if not pairs:
        return None
    cases = {}
    for pair in pairs:
        cases.setdefault(pair[0]["case"], []).append(pair)
    expected = {"cases": len(cases), "pairs": len(pairs)}
    expected |= {"unpaired_a": len(first) - len(pairs), "unpaired_b": len(second) - len(pairs)}
    for name, figure, most in [("sr", success, 100.0), ("spl", path_length, 1.0)]:
        means = np.array([np.mean([[figure(a), figure(b)] for a, b in of_case], axis=0) for of_case in cases.values()])
        differences = means[:, 0] - means[:, 1]
        expected[name] = {
            "a": np.mean(means[:, 0]),
            "b": np.mean(means[:, 1]),
            "mean": np.mean(differences),
            "interval": interval(differences, np.ones(len(differences)), -most, most),
        }
    more = [sum(1 if success(a) else -1 for a, b in of_case if success(a) != success(b)) for of_case in cases.values()]
    expected["more_under_a"] = better = sum(one > 0 for one in more)
    expected["more_under_b"] = worse = sum(one < 0 for one in more)
    expected["p"] = float(stats.binomtest(better, better + worse, 0.5).pvalue) if better + worse else 1.0
    assert not better + worse or abs(sign_test(more, 0)[1] - expected["p"]) < 1e-9
    expected["episodes_a"], expected["episodes_b"] = len(first), len(second)
    distances = [abs(np.mean([success(a) - success(b) for a, b in of_case])) for of_case in cases.values()]
    expected["points"] = np.sum(distances) / (better + worse) if better + worse else 100.0
    expected["pairs of cases"] = cases
    return expected


# What the comparisons of a command show together: Holm's correction from statsmodels, power from SciPy's binomial distribution.

LEVEL, POWER, MOST_CASES = 0.05, 0.8, 10_000


@functools.cache
def least_better(unequal, factor):
    """The smallest number of better cases among `unequal` that shows a difference; one more than `unequal` if none does."""
    if 2 * 0.5**unequal * factor >= LEVEL:
        return unequal + 1
    better = int(stats.binom.isf(LEVEL / 2 / factor, unequal, 0.5)) + 1
    # `isf` finds the largest tail of at most the level, and the level itself is never reached.
    assert 2 * stats.binom.sf(better - 1, unequal, 0.5) * factor < LEVEL <= 2 * stats.binom.sf(better - 2, unequal, 0.5) * factor
    return better


def power(cases, better, worse, factor):
    """The probability that A is shown to be better in so many cases, each better and worse with these probabilities."""
    unequal = np.arange(cases + 1)
    least = np.array([least_better(int(count), factor) for count in unequal])
    shown = stats.binom.sf(least - 1, unequal, better / (better + worse))
    return float(np.sum(stats.binom.pmf(unequal, cases, min(better + worse, 1.0)) * shown))


def power_at(excess, cases, unequal, factor):
    unequal = max(unequal, excess)
    return power(cases, (unequal + excess) / 2, (unequal - excess) / 2, factor)


def conclusion_agrees(found, expected, factor, checks_cases):
    """Checks the conclusion of a comparison. Power at thousands of cases takes long, so `checks_cases` says whether it is checked."""
    cases, better, worse = (expected[name] for name in ("cases", "more_under_a", "more_under_b"))
    shown = found["corrected_p"] < LEVEL
    verdict = ("better" if better > worse else "worse") if shown else "no-difference-shown"
    assert (found["verdict"], found["factor"]) == (verdict, factor), (found, factor)
    unequal = (better + worse) / cases
    if found["detectable"] is None:
        assert power_at(1.0, cases, unequal, factor) < POWER
    else:
        excess = found["detectable"] / expected["points"]
        assert abs(power_at(excess, cases, unequal, factor) - POWER) < 1e-6, found
    more = found["more_cases"]
    if shown or better == worse:
        assert more is None
    elif checks_cases and more is not None and cases + more < 300:
        at = lambda count: power(count, max(better, worse) / cases, min(better, worse) / cases, factor)
        assert at(cases + more) >= POWER and (more == 1 or at(cases + more - 1) < POWER), found
        return 1
    return 0


def left_out_agrees(found, cases, factor):
    """Checks which verdicts change without a task, a repetition and a case."""

    def verdict(pairs):
        by_case = {}
        for a, b in pairs:
            by_case[a["case"]] = by_case.get(a["case"], 0) + (success(a) > success(b)) - (success(a) < success(b))
        better, worse = (sum(sign * more > 0 for more in by_case.values()) for sign in (1, -1))
        p = stats.binomtest(better, better + worse, 0.5).pvalue if better + worse else 1.0
        return ("better" if better > worse else "worse") if p * factor < LEVEL else "no-difference-shown"

    pairs = [pair for of_case in cases.values() for pair in of_case]
    of_all = verdict(pairs)
    for kind, part in [("tasks", "task"), ("repetitions", "run"), ("cases", "case")]:
        parts = {a[part] for a, _ in pairs}
        rest = {one: [pair for pair in pairs if pair[0][part] != one] for one in parts}
        found_without = {str(one): verdict(left) for one, left in rest.items() if left}
        changed = {one: other for one, other in found_without.items() if other != of_all}
        told = found["robustness"][kind]
        assert told["parts"] == (len(parts) if len(parts) > 1 else 0), (kind, told)
        assert {one["without"]: one["verdict"] for one in told["changes"]} == changed, (kind, told)


def of_cases(records, figure):
    """The mean over runs of each run's mean, and the mean and the weight of every case in it."""
    values = [(record, figure(record)) for record in records if figure(record) is not None]
    sizes, cases = {}, {}
    for record, _ in values:
        sizes[record["run"]] = sizes.get(record["run"], 0) + 1
    for record, value in values:
        cases.setdefault(record["case"], []).append((value, 1 / sizes[record["run"]]))
    weights = {case: sum(weight for _, weight in of_case) for case, of_case in cases.items()}
    means = {case: sum(value * weight for value, weight in of_case) / weights[case] for case, of_case in cases.items()}
    total = sum(weights.values())
    shares = {case: weight / total for case, weight in weights.items()}
    return (sum(shares[case] * means[case] for case in cases) if cases else None), means, shares


def own_figure(records, figure, most):
    mean, means, shares = of_cases(records, figure)
    if mean is None:
        return None
    of_runs = [np.mean([figure(one) for one in records if one["run"] == run and figure(one) is not None])
               for run in sorted({one["run"] for one in records if figure(one) is not None})]
    std = float(np.std(of_runs, ddof=1)) if len(of_runs) > 1 else None
    return {
        "mean": mean,
        "std": std,
        "runs": len(of_runs),
        "interval": interval([means[case] for case in means], [shares[case] for case in means], 0.0, most),
    }


def on_common_cases(arms):
    """Mean, number of cases and errors by case of each arm, on the cases that all have."""
    common = set.intersection(*({record["case"] for record in arm} for arm in arms))
    found = []
    for arm in arms:
        mean, means, shares = of_cases([record for record in arm if record["case"] in common], success)
        errors = np.array([shares[case] * (means[case] - mean) for case in sorted(common)])
        found.append((mean, 1 / sum(share**2 for share in shares.values()), errors))
    return found


def change(arms):
    (a, b, c, d), n, (ea, eb, ec, ed) = zip(*on_common_cases(arms))
    errors = (ea - eb) - (ec - ed)
    return {"value": (a - b) - (c - d), "interval": interval_from((a - b) - (c - d), np.sum(errors**2), min(n), -100.0, 100.0)}


def retention(arms):
    (after, n, errors_after), (before, m, errors_before) = on_common_cases(arms)
    n = min(n, m)
    if before == 0:
        return None
    # The ratios r for which the interval of `after - r before`, from -100 r to 100, holds 0.
    def excess(r):
        figure, low, high = after - r * before, -100.0 * r, 100.0
        middle = (n * figure + low + high) / (n + 2)
        variance = np.sum((errors_after - r * errors_before) ** 2)
        squares = n**2 * variance + n * (figure - middle) ** 2 + (low - middle) ** 2 + (high - middle) ** 2
        return middle**2 - stats.t.ppf(0.975, n + 1) ** 2 * squares / ((n + 1) * (n + 2))

    # It is a parabola in r.
    c, one, two = excess(0.0), excess(1.0), excess(2.0)
    a = (two - 2 * one + c) / 2
    b = one - c - a
    value = after / before
    if a <= 0:
        return {"value": value, "interval": None}
    root = math.sqrt(b * b - 4 * a * c)
    low, high = (-b - root) / (2 * a), (-b + root) / (2 * a)
    return {"value": value, "interval": {"low": min(max(low, 0.0), value), "high": max(high, value)}}


def score(program, *arguments):
    # Exit status 1 would say that episodes are missing.
    done = subprocess.run([program, "score", *arguments, "--json"], stdout=subprocess.PIPE, check=True, text=True)
    return json.loads(done.stdout)


def main(program, manifest, folder):
    manifest, folder = json.loads(pathlib.Path(manifest).read_text()), pathlib.Path(folder)
    random, run_seed = np.random.default_rng(SEED), manifest["settings"]["seed"]
    sides = [{}, {}]
    for index in range(PAIRS):
        condition = f"episodic/new/unchanged/4/h{index + 7}"
        cases = CASES[: random.integers(1, len(CASES) + 1)]
        kept = random.choice([1.0, 1.0, 0.6])
        for side in sides:
            side[condition] = draw_condition(random, condition, cases, int(random.integers(1, 6)), kept, run_seed)
    runs = [folder / name for name in "ab"]
    for run, side in zip(runs, sides):
        write_run(run, manifest, [record for records in side.values() for record in records])
    found = {one["a"].removeprefix("a: "): one for one in score(program, *map(str, runs))["comparisons"]}
    compared = {}
    for condition, first in sides[0].items():
        expected = comparison(first, sides[1][condition])
        assert (expected is None) == (condition not in found), condition
        if expected is not None:
            compared[condition] = expected
            figures = {name: value for name, value in expected.items() if name not in ("points", "pairs of cases")}
            near(found[condition], figures, condition)
    print(f"{len(found)} comparisons agree")

    values = np.array([compared[condition]["p"] for condition in compared])
    corrected = multipletests(values, method="holm")[1]
    checked = 0
    for index, (condition, expected) in enumerate(compared.items()):
        near(found[condition]["corrected_p"], float(corrected[index]), f"{condition}, corrected p")
        assert found[condition]["family"] == len(values)
        # What the correction multiplies p by: the number of comparisons less those of the others that are shown without this one,
        # which the step-down procedure finds from the smallest p on.
        others = np.sort(np.delete(values, index))
        is_shown = others * (len(values) - np.arange(len(others))) < LEVEL
        factor = len(values) - int(np.sum(np.logical_and.accumulate(is_shown)))
        checked += conclusion_agrees(found[condition], expected, factor, checked < 20)
        left_out_agrees(found[condition], expected["pairs of cases"], factor)
    print(f"{len(compared)} conclusions agree, {checked} of them about more cases")
    alone = next(iter(sorted(compared, key=lambda name: -compared[name]["cases"])))
    (one,) = score(program, *map(str, runs), "--compare", alone, alone)["comparisons"]
    near(one["corrected_p"], compared[alone]["p"], f"{alone}, alone")
    conclusion_agrees(one, compared[alone], 1, True)
    left_out_agrees(one, compared[alone]["pairs of cases"], 1)

    names = ["episodic/new/blocked/4", "episodic/new/unchanged/4", "working/new/blocked/none", "working/new/unchanged/none"]
    groups = []
    for index in range(20):
        cases = CASES[: random.integers(2, len(CASES) + 1)]
        kept = random.choice([1.0, 0.7])
        conditions = [f"{name}/h{index + 7}" for name in names]
        draw = lambda name: draw_condition(random, name, cases, int(random.integers(1, 5)), kept, run_seed)
        groups.append({name: draw(name) for name in conditions})
    records = [record for group in groups for arm in group.values() for record in arm]
    write_run(folder / "blocked", manifest, records)
    scores = {}
    for one in score(program, str(folder / "blocked"))["conditions"]:
        scores[f"{one['memory']}/{one['start']}/{one['route']}/{one['demonstrations']}/h{one['window']}"] = one
    for group in groups:
        for name, records in group.items():
            near(scores[name]["sr"], own_figure(records, success, 100.0), f"{name}, SR")
            near(scores[name]["spl"], own_figure(records, path_length, 1.0), f"{name}, SPL")
        name, arms = next(iter(group)), list(group.values())
        found = scores[name]["blocked"]
        near(found["follow"], own_figure(arms[0], tried, 100.0), f"{name}, F")
        near(found["recovery"], own_figure(arms[0], recovered, 100.0), f"{name}, C")
        near(found["change"], change(arms), f"{name}, Delta")
        near(found["retention"], retention(arms[:2]), f"{name}, R")
    print(f"{len(groups)} blocked conditions agree")


if __name__ == "__main__":
    main(*sys.argv[1:])
