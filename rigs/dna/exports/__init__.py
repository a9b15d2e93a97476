"""Export of other rigs as DNA files."""

from rigs.dna.exports.choice import draft_of as draft_of
