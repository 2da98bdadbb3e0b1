"""Reads a run, checks the types of its tables, and prints its episodes as JSON: `read_run.py RUN`."""

import json
import sys

import pandas as pd

from memtransfer.results import read

results = read(sys.argv[1])
episodes = results.episodes
kinds = {name: str(kind) for name, kind in episodes.dtypes.items()}
assert kinds["key"] == kinds["case"] == "string" and kinds["memory"] == "category", kinds
assert (kinds["steps"], kinds["success"], kinds["spl"]) == ("Int64", "boolean", "Float64"), kinds
assert (kinds["seed"], kinds["prompt_tokens"], kinds["sub_goals"]) == ("UInt64", "Int64", "Int64")
for name in ("unreadable", "empty", "refused", "sub_goals_met", "window", "run"):
    assert kinds[name] == "Int64", name
assert episodes["key"].is_unique
given_up = episodes["ending"] == "given-up"
assert episodes.loc[given_up, ["success", "spl", "steps"]].isna().all(axis=None)
assert episodes.loc[given_up, "error"].notna().all()
assert episodes.loc[~given_up, ["success", "spl", "steps"]].notna().all(axis=None)
assert (results.timings["decide_ns"] > 0).all()
assert len(results.timings) == (~given_up).sum()
assert not pd.isna(results.manifest["settings"]["seed"])
assert results.sessions[0]["event"] == "ready", results.sessions
columns = ["key", "memory", "case", "steps", "success", "spl", "seed"]
print(episodes[columns].astype(object).where(episodes[columns].notna(), None).to_json(orient="records"))
json.dumps(results.manifest)
