"""Real photographs with true poses of objects: a reader of data sets, and scores."""
