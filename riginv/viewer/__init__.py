"""Results to look at: a page that needs no network, and a picture."""
