"""A Sphinx extension: the reference is whole, and names of the library lead to it.

The build fails where a public name is missing from the reference or has no docstring.
"""

import ast
import inspect
import re
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer
from sphinx.transforms import SphinxTransform

NAME = re.compile(r"(?:cr\.)?([A-Za-z_][\w.]*)(?:\(.*\))?", re.DOTALL)
"""A public name as prose says it: ``learn``, ``cr.learn``, ``learn(...)``, ``Curriculum.train``."""
TYPE = ":type: "
"""What napoleon makes of the words before a colon at the beginning of a property's docstring."""


def said(package: ModuleType, name: str) -> str:
    """Return the docstring of a public name; a constant's is the string below its assignment."""
    found = getattr(package, name)
    if inspect.isclass(found) or inspect.isroutine(inspect.unwrap(found)):
        own = inspect.cleandoc(found.__doc__ or "")
        generated = own.startswith(f"{name}(")  # what a dataclass or NamedTuple is given
        return "" if generated else own
    module, original = _home(package, name)
    docs = ModuleAnalyzer.for_module(module).find_attr_docs()
    return "\n".join(docs.get(("", original), ()))


def _home(package: ModuleType, name: str) -> tuple[str, str]:
    """Return the module in which a name of the package's stub is assigned, and its name there."""
    stub = Path(str(package.__file__)).with_suffix(".pyi")
    for line in ast.parse(stub.read_text("utf-8")).body if stub.exists() else ():
        for alias in line.names if isinstance(line, ast.ImportFrom) else ():
            if (alias.asname or alias.name) == name:
                return f"{package.__name__}.{line.module}", alias.name
    return package.__name__, name


def faults(package: ModuleType, documented: Iterable[str]) -> Iterator[str]:
    """Yield a sentence for each public name that the reference leaves out or says nothing of."""
    written = set(documented)
    for name in package.__all__:
        if name not in written:
            yield f"{package.__name__}.{name} is public, and missing from the reference"
        if not said(package, name):
            yield f"{package.__name__}.{name} is public, and has no docstring"


def check(app: Any, env: Any) -> None:
    """Stop the build unless every public name is documented."""
    package = import_module(app.config.reference_package)
    prefix = f"{package.__name__}."
    objects = env.domains["py"].objects
    found = list(faults(package, [name.removeprefix(prefix) for name in objects]))
    if found:
        raise ExtensionError("\n".join(found))


def explain(app: Any, what: str, name: str, found: Any, options: Any, lines: list[str]) -> None:
    """Give constants their own docstring, and "A: b" back to properties, where A is no type."""
    if what == "data":
        package, _, constant = name.rpartition(".")
        lines[:] = [*said(import_module(package), constant).splitlines(), ""]
    elif what in ("property", "attribute") and lines and lines[-1].startswith(TYPE):
        lines[0] = f"{lines.pop().removeprefix(TYPE)}: {lines[0]}"


def skip(app: Any, what: str, name: str, found: Any, skipped: bool, options: Any) -> bool | None:
    """Leave out what looks like a method and is the default of a field: a function so named."""
    return True if inspect.isfunction(found) and found.__name__ != name else None


def resolve(app: Any, env: Any, node: pending_xref, content: nodes.Node) -> nodes.Node | None:
    """Return a link for a name that a docstring says without its package, or for a field.

    Fields have no place of their own: their class, which lists them, takes their place.
    """
    if node.get("refdomain") != "py":
        return None
    package = import_module(app.config.reference_package)
    *_, owner, name = [node.get("py:class") or "", *node["reftarget"].split(".")]
    page = name if name in package.__all__ else owner if _public(package, owner, name) else None
    if page is None:
        return None
    target, python = f"{package.__name__}.{page}", env.domains["py"]
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, content)


def _public(package: ModuleType, name: str, member: str = "", *deeper: str) -> bool:
    """Return whether a name is public, or a field or method of a public one."""
    if name not in package.__all__ or deeper:
        return False
    found = getattr(package, name)
    return not member or hasattr(found, member) or member in getattr(found, "__annotations__", ())


class Links(SphinxTransform):
    """Makes public names in the prose of Markdown pages links to the reference."""

    default_priority = 400

    def apply(self, **_: Any) -> None:
        """Wrap each literal that is a public name, outside titles and links."""
        package = import_module(self.config.reference_package)
        for literal in list(self.document.findall(nodes.literal)):
            found = NAME.fullmatch(literal.astext())
            inside = isinstance(literal.parent, nodes.title | nodes.reference | pending_xref)
            if inside or not found or not _public(package, *found[1].split(".")):
                continue
            target = f"{package.__name__}.{found[1]}"
            link = pending_xref("", refdomain="py", reftype="obj", reftarget=target)
            link["refdoc"] = self.env.docname
            literal.replace_self(link)
            link += literal


def setup(app: Any) -> dict[str, Any]:
    """Register all this with Sphinx."""
    app.add_config_value("reference_package", "", "env")
    app.add_transform(Links)
    app.connect("autodoc-process-docstring", explain, priority=600)  # after napoleon's
    app.connect("autodoc-skip-member", skip)
    app.connect("missing-reference", resolve)
    app.connect("env-check-consistency", check)
    return {"parallel_read_safe": True}
