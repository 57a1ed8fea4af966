"""Order and cycles of forests, given as a map from each name to its parent's."""

from collections.abc import Mapping


def parents_first(parents: Mapping[str, str | None]) -> list[str]:
    """Return the names of an acyclic forest: parents first, otherwise in the given order."""
    ordered: dict[str | None, None] = {None: None}
    while len(ordered) <= len(parents):
        for name, parent in parents.items():
            if parent in ordered:
                ordered.setdefault(name)
    return [name for name in ordered if name is not None]


def name_on_cycle(parents: Mapping[str, str | None]) -> str | None:
    """Return a name that is its own ancestor, or None; missing names have no parent."""
    for start in parents:
        visited, name = {start}, parents[start]
        while name is not None:
            if name in visited:
                return name
            visited.add(name)
            name = parents.get(name)
    return None
