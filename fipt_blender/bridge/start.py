"""Run a module of this package in any Python, by the path of this file: start.py MODULE ARGUMENTS.

The package is loaded from its folder, because the folder of an extension is beside those of other extensions,
which must not become importable in the engine. Standard library only.
"""

from __future__ import annotations

import importlib.util
import runpy
import sys
from pathlib import Path


def main() -> None:
    """Run the module named by the first argument as the main program."""
    folder, module = Path(__file__).resolve().parent.parent, sys.argv.pop(1)
    spec = importlib.util.spec_from_file_location(
        "fipt_blender", folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None and spec.loader is not None
    package = importlib.util.module_from_spec(spec)
    sys.modules["fipt_blender"] = package
    spec.loader.exec_module(package)
    runpy.run_module(module, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
