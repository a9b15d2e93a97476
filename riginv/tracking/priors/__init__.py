"""Which controls go together, learned from takes or made up."""
