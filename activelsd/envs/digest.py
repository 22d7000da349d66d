"""A digest of the code that views are made by, so that a change of it makes them anew."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

_LEFT_OUT = frozenset(
    {
        *("activelsd.errors", "activelsd.registry", "activelsd.sections", "activelsd.subprogram"),
        *("activelsd.envs.cache", "activelsd.envs.cores", "activelsd.envs.digest", "activelsd.envs.locks"),
        *("activelsd.envs.episode", "activelsd.envs.viewgraph", "activelsd.envs.workers"),
    }
)
"""What starts processes, keeps files and plays episodes: it runs the code that makes views, and changes none.
`viewgraph.FORMAT` stands for the file's format. Modules called `settings` are left out too: the
settings that matter are in a cache's key."""


@lru_cache
def code_digest(*modules: str) -> str:
    """A digest of modules and of all that they import, directly or not, within their top-level packages.

    Imports are found by parsing, those inside functions too. Comments, docstrings and the layout of the code
    do not count.

    Args:
        modules: their full names; of any package.

    Raises:
        ModuleNotFoundError: there is no source of one of them.
    """
    for name in modules:
        if _source(name) is None:
            raise ModuleNotFoundError(f"There is no source of the module {name}.", name=name)
    found: dict[str, str] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        known = name in found or name in _LEFT_OUT or name.endswith(".settings")
        file = None if known else _source(name)
        if file is not None:
            tree = ast.parse(file.read_bytes())
            statements = list(_without_docstrings(tree))
            package = name if file.name == "__init__.py" else name.rpartition(".")[0]
            top = name.partition(".")[0]
            waiting += [one for one in _imported(statements, package) if one.partition(".")[0] == top]
            found[name] = ast.dump(tree)
    return hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()[:16]


def _source(name: str) -> Path | None:
    """The file of a module, found without importing it; None if there is none."""
    top, *inner = name.split(".")
    spec = find_spec(top)
    if spec is None or spec.origin is None:
        return None
    if not inner:
        return Path(spec.origin)
    for folder in spec.submodule_search_locations or ():
        path = Path(folder, *inner)
        for file in (path / "__init__.py", path.parent / f"{path.name}.py"):
            if file.is_file():
                return file
    return None


def _without_docstrings(node: ast.AST) -> Iterator[ast.AST]:
    """Remove strings that are statements below a node, and give the other statements."""
    for field in ("body", "orelse", "handlers", "finalbody", "cases"):
        block: list[ast.AST] = getattr(node, field, [])
        block[:] = [one for one in block if not _is_docstring(one)]
        for statement in block:
            yield statement
            yield from _without_docstrings(statement)


def _is_docstring(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _imported(statements: Sequence[ast.AST], package: str) -> Iterator[str]:
    """Names that a module of a package imports; some may be of functions and not of modules."""
    for node in statements:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: package.count(".") + 2 - node.level] if node.level else []
            base = ".".join([*parents, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)
