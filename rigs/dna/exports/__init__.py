"""Rigs of other kinds as DNA files: what each kind is made of, in the terms of the format."""

from rigs.dna.exports.choice import draft_of as draft_of
