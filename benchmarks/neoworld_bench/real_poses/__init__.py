"""Real photographs with a sensor's depth or true poses: readers of data sets, and their scores."""
