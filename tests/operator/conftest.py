"""A film and its recording, made once; each test gets copies of its own, for answers are written beside them."""

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "io"), str(TESTS / "operator")]

from film import track_film, write_film  # noqa: E402

from spheremcap.operator.opened import Opened  # noqa: E402
from spheremcap.operator.page import Page  # noqa: E402


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    track_film(write_film(folder / "film.mp4"), folder / "film.mcap")
    return folder


@pytest.fixture
def film(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made / "film.mp4", tmp_path / "film.mp4"))


@pytest.fixture
def recording(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(made / "film.mcap", tmp_path / "out.mcap"))


@pytest.fixture
def paged() -> Iterator[Callable[..., Page]]:
    """Opens a page on a file; the time line has been read. Closed at the end."""
    pages = []

    def open_page(path: Path, **more: object) -> Page:
        page = Page(Opened(path, **more), "ada")  # type: ignore[arg-type]
        pages.append(page)
        if page._reading is not None:
            page._reading.join(30)
        return page

    yield open_page
    for page in pages:
        page.close()
