"""Controls over time, and the formats that hold them."""
