"""Trees that are given as a map from each name to its parent's: order and cycles."""

from collections.abc import Mapping


def parents_first(parents: Mapping[str, str | None]) -> list[str]:
    """Return the names, each after its parent, else in the given order."""
    ordered: dict[str | None, None] = {None: None}
    while len(ordered) <= len(parents):
        for name, parent in parents.items():
            if parent in ordered:
                ordered.setdefault(name)
    return [name for name in ordered if name is not None]


def name_on_cycle(parents: Mapping[str, str | None]) -> str | None:
    """Return a name that is its own ancestor; None where there is none."""
    for start in parents:
        visited, at = {start}, parents[start]
        while at is not None:
            if at in visited:
                return at
            visited.add(at)
            at = parents.get(at)
    return None
