"""The graph of imports between the modules of the package and of its kernels."""

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = {
    "neoworld_mjx": ROOT,
    "neoworld_kernels": ROOT / "kernels",
    "neoworld_bench": ROOT / "benchmarks",
}


def modules():
    """Every module's file by its dotted name."""
    files = {}
    for package, base in FOLDERS.items():
        for path in sorted((base / package).rglob("*.py")):
            parts = path.relative_to(base).with_suffix("").parts
            files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return files


def import_nodes(tree):
    """Imports at any depth of a module, those for type checkers included."""
    return (node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))


def imported(node, package, names):
    """Modules of the project that an import statement loads or takes names from."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names} & names
    base = node.module or ""
    if node.level:
        parts = package.split(".")
        base = ".".join([*parts[: len(parts) - node.level + 1], *filter(None, [node.module])])
    targets = set()
    for alias in node.names:
        full = f"{base}.{alias.name}"
        targets.add(full if full in names else base)
    return targets & names


@cache
def import_graph():
    """Modules that each module imports, inside functions too."""
    files = modules()
    names, graph = set(files), {}
    for name, path in files.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        tree = ast.parse(path.read_text(encoding="utf-8"))
        targets = (imported(node, package, names) for node in import_nodes(tree))
        graph[name] = set().union(*targets) - {name}
    return graph


def cycle(graph):
    """A list of modules that import each other in a circle, or None."""
    completed, path = set(), []

    def visit(name):
        if name in path:
            return [*path[path.index(name) :], name]
        if name in completed:
            return None
        path.append(name)
        for target in sorted(graph[name]):
            if circle := visit(target):
                return circle
        path.pop()
        completed.add(name)
        return None

    return next(filter(None, map(visit, sorted(graph))), None)


def packages(graph):
    """The graph between packages: a library's modules at the top stand for themselves."""
    owner = {name: ".".join(name.split(".")[:2]) for name in graph}
    result = {package: set() for package in owner.values()}
    for name, targets in graph.items():
        result[owner[name]] |= {owner[target] for target in targets} - {owner[name]}
    return result


def test_no_module_imports_itself_in_a_circle():
    circle = cycle(import_graph())
    assert circle is None, " -> ".join(circle)


def test_no_package_imports_itself_in_a_circle():
    circle = cycle(packages(import_graph()))
    assert circle is None, " -> ".join(circle)


def test_what_engines_import_imports_no_engine():
    from neoworld_mjx.engines import ENGINES

    graph = import_graph()
    engines = {f"neoworld_mjx{entry.location.partition(':')[0]}" for entry in ENGINES.values()}
    assert engines <= set(graph)
    vocabulary = {f"neoworld_mjx.physics.{name}" for name in ("engine", "recorder", "model")}
    reached, todo = set(), list(vocabulary)
    while todo:
        name = todo.pop()
        reached.add(name)
        todo.extend(graph[name] - reached)
    assert not reached & engines
