"""Let a simulator or reader by others process files, and print a line of JSON for each.

The script runs in an environment with that program and does not need this package. Jobs are JSON on
standard input: a list of `{"read": FILE}` and `{"move": FILE, ...options of motion_probe}`.

    echo '[{"read": "object.sdf"}]' | uv run --no-project --with drake benchmarks/probe.py drake
"""

import json
import sys
from importlib import import_module
from importlib.metadata import version

MARK = "@probe "
"""Prefix of our lines in the program's output."""


def main() -> None:
    # The script's folder is first on the path, where its modules would shadow packages.
    folder = sys.path.pop(0)
    sys.path.append(folder)
    read = import_module("reader_probe").READERS
    move = import_module("motion_probe").MOVERS
    sys.path.pop()
    name, package = sys.argv[1:3]
    print(f"{MARK}{json.dumps({'version': version(package)})}", flush=True)
    for job in json.load(sys.stdin):
        try:
            result = read[name](job["read"]) if "read" in job else move[name](job["move"], job)
        except Exception as error:  # Programs raise exceptions of many types.
            result = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]}
        # Programs may not end their lines.
        print(f"\n{MARK}{json.dumps(result)}", flush=True)


if __name__ == "__main__":
    main()
