"""Networks: from mesh coordinates to controls (inverse) and from controls to coefficients (surrogate)."""
