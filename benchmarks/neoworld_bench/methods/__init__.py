"""Methods that turn an initial scene into a layout, and their scores on the thirty scenes."""
