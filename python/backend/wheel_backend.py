"""The build backend of the package: maturin's, for a wheel that also has the programs.

The programs are built by cargo in the checkout's target folder, like those of `cargo xtask`, and become scripts of the wheel:
installers put them beside the environment's Python.
"""

from __future__ import annotations

import json
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import maturin
from maturin import (  # noqa: F401: hooks of the backend
    build_sdist,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

PROGRAMS = ("memtransfer", "sim-proc", "memory-proc", "policy-proc")

SCRIPTS = Path("target/wheel-data/scripts")
"""Relative to the project's root, in which hooks run. `data` in pyproject.toml names the folder above."""

# Without the folder, maturin refuses everything, even to tell the metadata.
SCRIPTS.mkdir(parents=True, exist_ok=True)

Config = Mapping[str, Any] | None


def build_wheel(wheel_directory: str, config_settings: Config = None, metadata_directory: str | None = None) -> str:
    settings = _with_programs(config_settings)
    return maturin.build_wheel(wheel_directory, settings, metadata_directory)


def build_editable(wheel_directory: str, config_settings: Config = None, metadata_directory: str | None = None) -> str:
    settings = _with_programs(config_settings)
    return maturin.build_editable(wheel_directory, settings, metadata_directory)


def _with_programs(config_settings: Config) -> dict[str, Any]:
    """Builds the programs. Returns the settings for maturin, with the tag that they need."""
    shutil.rmtree(SCRIPTS, ignore_errors=True)
    SCRIPTS.mkdir(parents=True)
    for built in _built_programs():
        script = SCRIPTS / built.name
        shutil.copy(built, script)
        subprocess.run(["strip", script], check=True)
    arguments = maturin.get_maturin_pep517_args(config_settings)
    if "--compatibility" not in arguments and platform.libc_ver()[0] == "glibc":
        arguments = [*arguments, "--compatibility", _manylinux()]
    return {**(config_settings or {}), "maturin.build-args": arguments}


def _built_programs() -> list[Path]:
    command = ["cargo", "build", "--release", "--locked", "--bins", "--message-format", "json-render-diagnostics"]
    for program in PROGRAMS:
        command += ["--package", program]
    output = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    messages = [json.loads(line) for line in output.splitlines()]
    built = [Path(message["executable"]) for message in messages if message.get("executable")]
    if {path.name for path in built} != {*PROGRAMS}:
        raise RuntimeError(f"cargo built {sorted(path.name for path in built)} instead of {sorted(PROGRAMS)}")
    return built


def _manylinux() -> str:
    """The tag for the newest version of glibc whose symbols the programs use."""
    versions = [re.findall(rb"GLIBC_2\.(\d+)\0", path.read_bytes()) for path in SCRIPTS.iterdir()]
    return f"manylinux_2_{max(int(version) for found in versions for version in found)}"
