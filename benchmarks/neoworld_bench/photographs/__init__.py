"""The bundled examples, and the composed scene of one of them."""
