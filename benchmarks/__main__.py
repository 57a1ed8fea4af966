"""Run a developer suite: `uv run python -m benchmarks SUITE [--json]`, from the root of a clone."""

import sys
from collections.abc import Sequence

import tyro
from neoworld_bench.bench_commands import suite_commands
from tyro.conf import DisallowNone, FlagCreatePairsOff

from benchmarks.suites import SUITES
from neoworld_mjx import cli


def main(args: Sequence[str] | None = None) -> None:
    """Run the command line and exit."""
    command = tyro.cli(
        suite_commands(SUITES),
        prog="python -m benchmarks",
        description="Run the benchmarks for developers of the package.",
        args=args,
        config=(FlagCreatePairsOff, DisallowNone),
    )
    sys.exit(cli.run(command))


if __name__ == "__main__":
    main()
