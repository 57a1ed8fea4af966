"""Write the generated pages of options into this checkout.

Run `python -m neoworld_mjx.config --write`.
"""

import sys
from pathlib import Path

from .pages import write_pages

if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python -m neoworld_mjx.config --write")
    write_pages(Path(__file__).parents[2])
