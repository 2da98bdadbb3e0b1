"""Names that are not known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Returns the end of a message about an unknown name: the nearest of those that are known, if one is near."""
    near = difflib.get_close_matches(name.replace("-", "_").lower(), known, 1)
    return f": did you mean {near[0]!r}?" if near else ""
