"""Views of a run: the report, and the pages of `neoworld view` and `neoworld annotate`.

Viser serves each page as one file that loads nothing from the network. All text from files is
escaped, and all input from a page is bounded.
"""
