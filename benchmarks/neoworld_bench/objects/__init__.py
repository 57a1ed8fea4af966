"""Made objects held against true ones: joints and surfaces."""
