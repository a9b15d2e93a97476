"""A studio's face: a folder of shapes behind an animator's controls."""
