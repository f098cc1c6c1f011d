"""Lies here so that pytest puts this folder on the path: tests in folders import scenes, clips and reference."""

from hypothesis import settings

from spheremcap.core.compiled import notice

# A first call may compile, and machines are busy: no deadline. What passed here passes elsewhere: no new examples, but
# with --hypothesis-profile explore.
settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None, max_examples=1000)
settings.load_profile("same")


def pytest_collection_finish() -> None:
    """What was compiled because a test's module needs it is not for the first command that a test runs to tell of."""
    notice.done()
