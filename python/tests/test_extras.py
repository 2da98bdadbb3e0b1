"""What is said where an extra is not installed."""

from __future__ import annotations

import importlib
import sys

import pytest


@pytest.mark.parametrize(
    ("module", "library", "extra"),
    [
        ("results", "pandas", "results"),
        ("gym", "gymnasium", "gym"),
        ("gym_world", "gymnasium", "gym"),
        ("inspect_tasks", "inspect_ai", "inspect"),
        ("ray", "ray", "ray"),
    ],
)
def test_a_module_without_its_library_names_the_extra(
    module: str, library: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    monkeypatch.delitem(sys.modules, f"memtransfer.{module}", raising=False)
    with pytest.raises(ModuleNotFoundError, match=rf"run pip install 'memtransfer\[{extra}\]'$"):
        importlib.import_module(f"memtransfer.{module}")
