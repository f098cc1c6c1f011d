"""A recording with a person's answers in it: what they change is tracked again, all else is copied as it is.

The recording holds the track without any answer, its base: on channels of its own, or, where answers changed it before,
under /replaced. So whatever has been answered, the base can be had back, and all answers are put in anew: what comes
out depends on base and answers alone.
"""
