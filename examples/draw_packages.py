"""Draw the packages of the repository and their imports, measured from the code, as an SVG.

    uv run python examples/draw_packages.py docs/pictures/architecture.svg

Rows are layers: a package imports only packages below it, or the drawing fails.
"""

import ast
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "neoworld_mjx": ROOT,
    "neoworld_kernels": ROOT / "kernels",
    "neoworld_bench": ROOT / "benchmarks",
}
SMALL = {"benchmark", "cache", "cli", "engines", "errors", "names", "options", "places", "progress"}
SMALL |= {"quantities"}
WIDTH, HEIGHT, GAP, ROW = 108, 30, 10, 62


def package_of(module: str) -> str | None:
    """Return the package of a module: one of the library's, or the whole of another."""
    top, *rest = module.split(".")
    if top not in FOLDERS:
        return None
    if top != "neoworld_mjx":
        return top
    return rest[0] if rest and rest[0] not in SMALL else None


def package_imports() -> dict[str, set[str]]:
    """Return the packages that each package imports."""
    imports: dict[str, set[str]] = defaultdict(set)
    for top, base in FOLDERS.items():
        for path in (base / top).rglob("*.py"):
            parts = path.relative_to(base).with_suffix("").parts
            here = package_of(".".join(parts))
            if here in (None, "__init__") or parts[-2] == "programs":
                continue
            imports[here] |= set()
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if not isinstance(node, ast.ImportFrom):
                    continue
                module = node.module or ""
                if node.level:
                    module = ".".join([*parts[: len(parts) - node.level], *filter(None, [module])])
                there = package_of(module)
                if there is not None and there != here:
                    imports[here].add(there)
    return imports


def layers(imports: dict[str, set[str]]) -> list[list[str]]:
    """Return packages by their height above those that import nothing, the lowest last.

    Raises:
        ValueError: packages import each other in a cycle.
    """
    heights: dict[str, int] = {}
    while len(heights) < len(imports):
        ready = [p for p in imports if p not in heights and imports[p] <= heights.keys()]
        if not ready:
            raise ValueError(f"a cycle among {sorted(set(imports) - heights.keys())}")
        for package in ready:
            heights[package] = 1 + max((heights[below] for below in imports[package]), default=-1)
    rows: dict[int, list[str]] = defaultdict(list)
    for package, height in heights.items():
        rows[height].append(package)
    return [sorted(rows[height]) for height in sorted(rows, reverse=True)]


def direct(imports: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the imports that do not follow from others."""

    def reachable(package: str) -> set[str]:
        return imports[package].union(*map(reachable, imports[package]))

    return {
        package: below - set().union(*map(reachable, below)) for package, below in imports.items()
    }


def drawing(imports: dict[str, set[str]]) -> str:
    """Return the SVG: a box for each package, and a line for each direct import."""
    rows = layers(imports)
    width = max(len(row) for row in rows) * (WIDTH + GAP) + GAP
    place = {}
    for y, row in enumerate(rows):
        left = (width - len(row) * (WIDTH + GAP) + GAP) / 2
        for x, package in enumerate(row):
            place[package] = (left + x * (WIDTH + GAP), GAP + y * ROW)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {len(rows) * ROW}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="12">',
        f'<rect width="{width}" height="{len(rows) * ROW}" fill="#fff"/>',
    ]
    for package, below in sorted(direct(imports).items()):
        x, y = place[package]
        for other in sorted(below):
            u, v = place[other]
            lines.append(
                f'<line x1="{x + WIDTH / 2:g}" y1="{y + HEIGHT:g}" x2="{u + WIDTH / 2:g}" '
                f'y2="{v:g}" stroke="#9aa7bd"/>'
            )
    for package, (x, y) in sorted(place.items()):
        lines.append(
            f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5" fill="#f6f6f6" '
            f'stroke="#5b7db1"/><text x="{x + WIDTH / 2:g}" y="{y + 19:g}" text-anchor="middle" '
            f'fill="#1d2b44">{package}</text>'
        )
    return "\n".join([*lines, "</svg>"]) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(drawing(package_imports()), encoding="utf-8")
