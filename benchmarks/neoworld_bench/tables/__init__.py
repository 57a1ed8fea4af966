"""Tables and curves of results."""
