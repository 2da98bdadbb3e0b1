"""Makes a folder of Python packages with an interpreter of its own (a virtual environment).

    python3 make_environment.py OUTPUT REQUIREMENTS WHEELS

REQUIREMENTS names all packages. Each is a wheel whose SHA-256 is there; pip refuses any other. A package
without a wheel is named there with `--no-binary`, and built from its sources. A wheel that lies in the folder
WHEELS is not downloaded. Needs Python's standard library and pip; Debian's `python3-venv` is not needed,
because the environment contains the pip that REQUIREMENTS names.

OUTPUT can be moved once it is finished. So nothing in it names its place: there are no `activate`
scripts, and programs of packages are run as `OUTPUT/bin/python -m NAME`.
"""

import os
import pathlib
import subprocess
import sys
import venv


class Movable(venv.EnvBuilder):
    def setup_scripts(self, context):
        """No `activate`: it would name the folder in which the environment is made."""


def main(output, requirements, wheels):
    Movable(symlinks=True, with_pip=False).create(output)
    (packages,) = pathlib.Path(output, "lib").glob("python3.*/site-packages")
    install = [sys.executable, "-m", "pip", "install", "--target", packages]
    install += ["--require-hashes", "--no-deps", "--only-binary", ":all:", "--find-links", wheels]
    install += ["--no-cache-dir", "--no-input", "--disable-pip-version-check", "--quiet"]
    # Python writes bytecode when something is imported first; packages of the machine are not in play.
    install += ["--no-compile", "--no-warn-conflicts"]
    install += ["--retries", "2", "--requirement", requirements]
    # What pip leaves when it is killed goes where set-up cleans up.
    variables = {"TMPDIR": os.path.dirname(output), "PIP_ROOT_USER_ACTION": "ignore"}
    done = subprocess.run(install, env={**os.environ, **variables}, stdin=subprocess.DEVNULL)
    if done.returncode != 0:
        sys.exit(f"pip could not install {requirements}; its own words are above")
    # A finished folder gets its name at once, so its files have to be on the disk before.
    os.sync()


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(f"usage: {sys.argv[0]} OUTPUT REQUIREMENTS WHEELS")
    main(*sys.argv[1:])
