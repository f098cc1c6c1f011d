"""Several recordings and sensor files on one time line. The package itself can be called: `spheremcap.merge(...)`."""

import sys
from types import ModuleType
from typing import Any


class _Package(ModuleType):
    """Lets spheremcap.merge be the function, although Python binds a package to its name when it is imported."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        from spheremcap.merge.dataset import merge

        return merge(*arguments, **options)


sys.modules[__name__].__class__ = _Package
