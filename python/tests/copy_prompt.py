"""Copies the texts of the harness's prompt into the package: TOML there, JSON here, because Python 3.10
cannot read TOML.
"""

import json
import tomllib
from pathlib import Path

root = Path(__file__).parents[2]
texts = tomllib.loads((root / "policy-proc/prompt/v1.toml").read_text(encoding="utf-8"))
copy = json.dumps(texts, ensure_ascii=False, indent=1) + "\n"
(root / "python/memtransfer/_prompt.json").write_text(copy, encoding="utf-8")
