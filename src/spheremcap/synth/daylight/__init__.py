"""The second renderer: a small world in daylight, cast by rays. It shares the nouns with the first one and nothing
else."""
