"""Write the pages of options of the checkout that this package lies in."""

from pathlib import Path

from .pages import write_pages

if __name__ == "__main__":
    write_pages(Path(__file__).parents[2])
