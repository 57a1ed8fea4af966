"""Engine suites: speed, agreement and the scenes that they run on."""
