"""The pages that `neoworld view` and `neoworld annotate` serve: a scene to look at and change.

The page is viser's, one file that loads nothing from the network. Everything that it shows of a
file is escaped, and what it sends back is bounded; programs run in the sandbox as elsewhere.
"""
