"""What every baseline here is: a loop over requests, a JSON object a line, each answered with one.

A request names what is to be done under "do"; the rest are arguments by name:

    {"do": "time", "threads": 2}    ->    {"seconds": 0.25}

What a baseline's package prints must not get among the answers, so standard output is turned to standard error, and
answers go out through a copy that was made before.
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
