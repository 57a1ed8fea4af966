"""Order and cycles of forests; a forest is a map from each name to the name of its parent."""

from collections.abc import Mapping


def parents_first(parents: Mapping[str, str | None]) -> list[str]:
    """Return the names of an acyclic forest, parents before children.

    Otherwise, names keep the order of `parents`.
    """
    ordered: dict[str | None, None] = {None: None}
    while len(ordered) <= len(parents):
        for name, parent in parents.items():
            if parent in ordered:
                ordered.setdefault(name)
    return [name for name in ordered if name is not None]


def name_on_cycle(parents: Mapping[str, str | None]) -> str | None:
    """Return a name on a cycle (a name that is its own ancestor), or None if there is no cycle.

    Names that are not in `parents` have no parent.
    """
    for start in parents:
        visited, name = {start}, parents[start]
        while name is not None:
            if name in visited:
                return name
            visited.add(name)
            name = parents.get(name)
    return None
