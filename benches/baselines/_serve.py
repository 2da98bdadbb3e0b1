"""The loop that every baseline runs: it reads requests, one JSON object per line, and answers each with one.

A request names the action under "do"; the other fields are its arguments:

    {"do": "time", "threads": 2}    ->    {"seconds": 0.25}

Packages may print to standard output, which would mix with the answers. Standard output is therefore redirected to
standard error, and answers are written to a duplicate of the original.
"""

import json
import os
import sys
import traceback


def serve(**actions):
    """Answers requests with the function of that name until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer = actions[request.pop("do")](**request)
        except Exception as error:
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)
