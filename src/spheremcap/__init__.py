"""Track coloured sphere markers in video and write every circle, 3D pose and vote into an annotated MCAP."""

__version__ = "0.1.0"
