"""Step 5: CEM-based scene refinement (paper Section 3.3, Algorithm 1)."""
