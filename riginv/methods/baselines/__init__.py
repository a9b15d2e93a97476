"""The prior methods that the paper cites."""
