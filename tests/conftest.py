"""Lies here so that pytest puts this folder on the path: tests in folders import scenes, clips and reference."""
