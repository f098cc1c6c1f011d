"""The session's page."""

from collections.abc import Sequence

from spheremcap.analysis.cycles import Band
from spheremcap.analysis.findings import Findings


def page(found: Findings, bands: Sequence[Band]) -> str:
    """One self-contained page."""
    return f"<p>{found.session.name}</p>"
