"""Browser pages of `neoworld view` and `neoworld annotate`.

Viser serves each page as one file that loads nothing from the network. All text from files is
escaped, all input from the page is bounded, and programs run in the sandbox.
"""
