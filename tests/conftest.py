"""Lies here so that pytest puts this folder on the path: tests in folders import scenes, clips and reference."""

from hypothesis import settings

settings.register_profile("no clock", deadline=None)  # a first call may compile, and machines are busy
settings.load_profile("no clock")
