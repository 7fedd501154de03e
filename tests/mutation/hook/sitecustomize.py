"""Loads one module from the source of a mutant, in pytest and in the Python programs it starts.

The directory of this file is put on PYTHONPATH, so that a program started by a test imports it.
"""

import os
import sys
from importlib.machinery import PathFinder, SourceFileLoader

MODULE, SOURCE = "DROPSTITCH_MUTANT_MODULE", "DROPSTITCH_MUTANT_SOURCE"


class _Loader(SourceFileLoader):
    def get_code(self, fullname):
        with open(os.environ[SOURCE], "rb") as file:
            return compile(file.read(), self.path, "exec", dont_inherit=True)


class _Finder:
    def find_spec(self, fullname, path=None, target=None):
        if fullname != os.environ[MODULE]:
            return None
        spec = PathFinder.find_spec(fullname, path)
        spec.loader = _Loader(fullname, spec.origin)
        return spec


def install():
    sys.meta_path.insert(0, _Finder())


if MODULE in os.environ:
    install()
