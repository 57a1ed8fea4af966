"""Object categories: size range and outline of objects, by the head noun of a label.

The ranges are deliberately wide: they reject a cup of 1 m, but accept a cup of 18 cm.
"""

import re
from typing import Literal, NamedTuple, cast

Outline = Literal["box", "round", "tapered", "ball", "handled", "spoon", "loose"]
"""Shape of an object within its 3D box:

- "box": the box itself,
- "round": an upright cylinder,
- "tapered": an upright cylinder with a narrower foot,
- "ball": a ball,
- "handled": a round body with a handle at its front,
- "spoon": a lying bowl with a thin handle at its back,
- "loose": a shape between box and cylinder.
"""


class Category(NamedTuple):
    """Size range and outline of the objects of a category."""

    low: float
    """Longest edge of the smallest common object [m]."""
    high: float
    """Longest edge of the largest common object [m]."""
    outline: Outline


_SMALLER = frozenset(["small", "little", "mini", "miniature", "tiny", "toy"])
_LARGER = frozenset(["large", "big", "giant", "tall", "floor", "standing", "wall"])


_TABLE = """
cup mug teacup | 0.04 0.18 handled
glass tumbler goblet wineglass | 0.05 0.30 round
saucer | 0.08 0.22 tapered
plate | 0.10 0.45 tapered
dish | 0.05 0.45 tapered
bowl basin | 0.07 0.60 tapered
bottle flask thermos | 0.08 0.50 round
can tin | 0.04 0.35 round
jar canister | 0.04 0.35 round
vase flowerpot carafe | 0.06 0.80 round
pitcher jug | 0.08 0.50 handled
candle | 0.02 0.35 round
pot kettle teapot casserole | 0.10 0.65 loose
saucepan pan skillet wok | 0.12 0.75 handled
bucket bin basket | 0.10 1.00 tapered
roll | 0.03 0.60 round
tape | 0.03 0.30 round
clock | 0.04 0.80 loose
lemon lime egg plum apricot walnut | 0.02 0.12 ball
apple orange peach pear tomato onion potato mango | 0.03 0.18 ball
ball | 0.02 0.80 ball
melon watermelon pumpkin | 0.10 0.70 ball
globe | 0.08 1.50 loose
banana carrot cucumber corn eggplant zucchini | 0.06 0.45 loose
bread loaf | 0.06 0.50 loose
spoon teaspoon tablespoon fork spatula ladle | 0.08 0.50 spoon
knife whisk tongs chopstick brush | 0.08 0.50 loose
pen pencil marker screwdriver toothbrush | 0.06 0.35 loose
scissors hammer pliers wrench drill | 0.08 0.45 loose
key coin ring screw nut bolt | 0.01 0.12 loose
phone smartphone calculator remote controller | 0.07 0.28 box
mouse | 0.05 0.18 loose
keyboard | 0.20 0.60 box
laptop tablet notebook | 0.12 0.50 box
monitor screen television tv | 0.25 2.00 box
book magazine | 0.08 0.50 box
paper card envelope | 0.04 0.80 box
box carton package packet parcel | 0.02 1.20 box
bag sachet | 0.03 1.00 loose
block brick cube dice | 0.01 0.40 box
tray | 0.05 1.20 box
board | 0.10 1.20 box
lid cap cover | 0.02 0.60 loose
sponge soap | 0.04 0.25 box
cloth towel napkin rag mat rug | 0.08 4.00 loose
glasses sunglasses | 0.08 0.22 loose
lamp light | 0.08 2.20 loose
plant flower | 0.03 2.50 loose
toy figure figurine statuette doll | 0.02 1.00 loose
toaster blender mixer | 0.12 0.60 loose
microwave oven | 0.30 1.00 box
fridge refrigerator | 0.40 2.20 box
dishwasher washer dryer stove | 0.40 1.30 box
sink | 0.20 1.20 box
cabinet cupboard drawers dresser wardrobe chest bookcase bookshelf nightstand | 0.25 3.50 box
drawer | 0.10 1.50 box
shelf | 0.15 4.00 box
rack | 0.06 4.00 loose
door window | 0.30 4.00 box
chair stool armchair bench | 0.25 2.50 loose
sofa couch bed | 1.00 3.50 loose
table desk counter countertop tabletop worktop island | 0.20 8.00 loose
top surface | 0.10 8.00 box
floor ground wall ceiling carpet | 0.20 50.0 box
"""


def _parse_table() -> dict[str, Category]:
    categories = {}
    for line in _TABLE.strip().splitlines():
        words, values = line.split("|")
        low, high, outline = values.split()
        for word in words.split():
            categories[word] = Category(float(low), float(high), cast(Outline, outline))
    return categories


CATEGORIES = _parse_table()


def size_range(label: str) -> tuple[float, float] | None:
    """Return the range of longest edges [m] for a label; words like "small" and "large" widen it.

    Returns:
        The lower and the upper limit, or None if the category is unknown.
    """
    category = category_of(label)
    if category is None:
        return None
    words = set(re.findall(r"[a-z]+", label.lower()))
    low = category.low / 2 if words & _SMALLER else category.low
    return low, category.high * 2 if words & _LARGER else category.high


def category_of(label: str) -> Category | None:
    """Return the category of a label's head noun: "soup can" is a can, "box of tea" is a box.

    Returns:
        The category, or None if no word of the label is in the table.
    """
    words = re.findall(r"[a-z]+", re.split(r"\b(?:of|with|for|in|on)\b", label.lower())[0])
    for word in reversed(words):
        for form in (word, word.removesuffix("s"), word.removesuffix("es")):
            if form in CATEGORIES:
                return CATEGORIES[form]
    return None
