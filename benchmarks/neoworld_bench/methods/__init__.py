"""Methods that turn an initial scene into a layout, run over scenes and initial scenes."""
