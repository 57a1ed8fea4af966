"""Step 4: deterministic scene composition (paper Section 3.3)."""
