#!/usr/bin/env python3
"""Executes the lines of the Containerfile in root file systems that debootstrap makes, for machines without a container builder.

    apt-get install debootstrap
    python3 examples/machines/containerfile_in_a_folder.py /tmp/image

Needs root. The stages become /tmp/image/0 and /tmp/image/1. Of the images that stages start from, `debian` is debootstrap's
minimal system, and `rust` is that with a C compiler and the toolchain of this machine. Understands what our Containerfile uses:
FROM, RUN, COPY, WORKDIR, CMD. CMD is executed at the end, with --shm-size of shared memory.

If apt, pip or cargo need settings to reach their registries, --file copies a file or folder of this machine into every
root, and --pass hands on an environment variable.
"""

import argparse
import json
import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

# In namespaces of its own, so that neither mounts nor processes outlive the command.
ENTER = r"""
set -e
root=$1 shm=$2 toolchain=$3 folder=$4
shift 4
mount -t proc proc "$root/proc"
mount --rbind /sys "$root/sys"
mount -t tmpfs -o mode=755 dev "$root/dev"
for device in null zero full random urandom tty; do
    touch "$root/dev/$device"
    mount --bind "/dev/$device" "$root/dev/$device"
done
ln -s /proc/self/fd "$root/dev/fd"
mkdir "$root/dev/shm"
mount -t tmpfs -o "size=$shm" shm "$root/dev/shm"
if [ -n "$toolchain" ]; then
    mkdir -p "$root/usr/local/rust"
    mount --bind -o ro "$toolchain" "$root/usr/local/rust"
fi
mkdir -p "$root$folder"
exec chroot "$root" /usr/bin/env -i -C "$folder" "$@"
"""


class Stage:
    """A root file system, and what the lines before have set."""

    def __init__(self, options, number, image):
        self.options, self.root = options, options.folder / str(number)
        self.folder = "/"
        self.environment = {"HOME": "/root", "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
        self.environment |= {name: os.environ[name] for name in options.passed if name in os.environ}
        self.toolchain = ""
        subprocess.run(["cp", "-a", options.debian, self.root], check=True)
        for path in options.file:
            target = self.root / path.relative_to("/")
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_dir():
                shutil.rmtree(target)
            subprocess.run(["cp", "-a", path, target], check=True)
        name = image.split("/")[-1].split(":")[0]
        if name == "rust":
            found = subprocess.run(["rustc", "--print", "sysroot"], check=True, stdout=subprocess.PIPE, text=True)
            self.toolchain = found.stdout.strip()
            self.environment["PATH"] = "/usr/local/rust/bin:" + self.environment["PATH"]
            self.run("apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev ca-certificates")
        elif name != "debian":
            sys.exit(f"no root file system for the image {image}")

    def execute(self, command, shm="64m"):
        variables = [f"{name}={value}" for name, value in self.environment.items()]
        enter = ["unshare", "--mount", "--pid", "--fork", "bash", "-c", ENTER, "enter"]
        subprocess.run([*enter, self.root, shm, self.toolchain, self.folder, *variables, *command], check=True)

    def run(self, line):
        self.execute(["/bin/sh", "-c", line])

    def copy(self, sources, target, source_root):
        into = self.root / target.lstrip("/")
        if source_root == REPOSITORY:
            ignored = (REPOSITORY / ".containerignore").read_text().split()
            into.mkdir(parents=True, exist_ok=True)
            pack = subprocess.Popen(
                ["tar", "-C", REPOSITORY, "-c", *(f"--exclude=./{name}" for name in ignored), "."],
                stdout=subprocess.PIPE,
            )
            subprocess.run(["tar", "-C", into, "-x", "--no-same-owner"], stdin=pack.stdout, check=True)
            if pack.wait() != 0:
                sys.exit("tar failed")
            return
        for source in sources:
            subprocess.run(["cp", "-a", source_root / source.lstrip("/"), into], check=True)


def lines(text):
    """The instructions, without comments; a backslash continues a line."""
    for line in text.replace("\\\n", " ").splitlines():
        if line.strip() and not line.startswith("#"):
            yield line.split(maxsplit=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the root file systems go; must not exist")
    parser.add_argument("--debian", type=Path, help="a root file system that debootstrap made (default: make one)")
    parser.add_argument("--file", type=Path, action="append", default=[], help="file or folder to copy into every root")
    parser.add_argument("--pass", dest="passed", action="append", default=[], help="environment variable to hand on")
    parser.add_argument("--shm-size", default="2g", help="shared memory of CMD")
    options = parser.parse_args()
    options.folder.mkdir(parents=True)
    if options.debian is None:
        options.debian = options.folder / "debian"
        subprocess.run(["debootstrap", "--variant=minbase", "bookworm", options.debian], check=True)
    stages, names, command = [], {}, None
    for instruction, rest in lines((REPOSITORY / "Containerfile").read_text()):
        print(f"--> {instruction} {rest}", flush=True)
        words = shlex.split(rest)
        if instruction == "FROM":
            stages.append(Stage(options, len(stages), words[0]))
            names |= {name: stages[-1].root for name in words[2:]}
        elif instruction == "RUN":
            stages[-1].run(rest)
        elif instruction == "COPY":
            source_root = REPOSITORY
            if words[0].startswith("--from="):
                source_root = names[words.pop(0).removeprefix("--from=")]
            stages[-1].copy(words[:-1], words[-1], source_root)
        elif instruction == "WORKDIR":
            stages[-1].folder = rest
        elif instruction == "CMD":
            command = json.loads(rest)
        else:
            sys.exit(f"this script does not know {instruction}")
    stages[-1].execute(command, options.shm_size)
    print("all lines of the Containerfile were executed")


if __name__ == "__main__":
    main()
