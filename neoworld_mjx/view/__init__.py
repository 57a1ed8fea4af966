"""Views of a run: the static report, and the browser pages of `view` and `annotate`."""
