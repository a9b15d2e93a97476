"""DNA files: read and written, evaluated, made into rigs, inverted, exported."""
