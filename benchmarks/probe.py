"""Let one foreign program read or simulate files, and print what came of it, a line of JSON each.

Run in an environment that has the program; it needs nothing of this package. Jobs are JSON on
standard input: a list of `{"read": FILE}` and `{"move": FILE, ...options of motion_probe}`.

    echo '[{"read": "object.sdf"}]' | uv run --no-project --with drake benchmarks/probe.py drake
"""

import json
import sys
from importlib import import_module
from importlib.metadata import version

MARK = "@probe "
"""Begins our lines among those of the program."""


def main() -> None:
    # A script's folder comes first on the path, where modules of ours would hide packages.
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
        except Exception as error:  # a foreign program's border
            result = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]}
        # Programs write on without ending their lines.
        print(f"\n{MARK}{json.dumps(result)}", flush=True)


if __name__ == "__main__":
    main()
