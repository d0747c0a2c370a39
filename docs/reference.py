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


def public_names(package: ModuleType) -> list[str]:
    """Return the names that a package offers; of one without a list, the classes it defines.

    Packages inside it are left out: they have pages of their own.
    """
    if hasattr(package, "__all__"):
        return [name for name in package.__all__ if not inspect.ismodule(getattr(package, name))]
    return [
        name
        for name, found in vars(package).items()
        if inspect.isclass(found) and found.__module__ == package.__name__
    ]


def homes(packages: Iterable[str]) -> dict[str, str]:
    """Return the package of each public name."""
    return {name: package for package in packages for name in public_names(import_module(package))}


def said(package: ModuleType, name: str) -> str:
    """Return the docstring of a public name; a constant's is the string below its assignment."""
    found = getattr(package, name)
    if inspect.isclass(found) or inspect.isroutine(inspect.unwrap(found)):
        own = inspect.cleandoc(found.__doc__ or "")
        generated = own.startswith(f"{name}(")  # what a dataclass or NamedTuple is given
        return "" if generated else own
    module, original = _origins(package).get(name, (package.__name__, name))
    docs = ModuleAnalyzer.for_module(module).find_attr_docs()
    return "\n".join(docs.get(("", original), ()))


def _origins(package: ModuleType) -> dict[str, tuple[str, str]]:
    """Return the module that each name of a package's stub is imported from, and its name there."""
    stub = Path(str(package.__file__)).with_suffix(".pyi")
    return {
        alias.asname or alias.name: (f"{package.__name__}.{line.module}", alias.name)
        for line in (ast.parse(stub.read_text("utf-8")).body if stub.exists() else ())
        if isinstance(line, ast.ImportFrom)
        for alias in line.names
    }


def write_pages(packages: Iterable[str], folder: Path) -> None:
    """Write a page for each package: what it is, and its public names under their modules."""
    for package in packages:
        module = import_module(package)
        origins = _origins(module)
        title = package.rpartition(".")[2].capitalize()
        parts = [f"{title}\n{'=' * len(title)}", inspect.cleandoc(module.__doc__ or "")]
        parts.append(f".. currentmodule:: {package}")
        grouped: dict[str, list[str]] = {}
        for name in public_names(module):
            grouped.setdefault(origins.get(name, (package, name))[0], []).append(name)
        for origin, names in sorted(grouped.items()):
            if origin != package:
                heading = origin.rpartition(".")[2].replace("_", " ").capitalize()
                summary = inspect.cleandoc(import_module(origin).__doc__ or "").partition("\n\n")[0]
                parts += [f"{heading}\n{'-' * len(heading)}", summary]
            listed = "\n".join(f"   {name}" for name in names)
            parts.append(f".. autosummary::\n   :toctree: generated\n   :nosignatures:\n\n{listed}")
        (folder / f"{title.lower()}.rst").write_text("\n\n".join(parts) + "\n", "utf-8")


def faults(package: ModuleType, documented: Iterable[str]) -> Iterator[str]:
    """Yield a sentence for each public name that the reference leaves out or says nothing of."""
    written = set(documented)
    for name in public_names(package):
        if f"{package.__name__}.{name}" not in written:
            yield f"{package.__name__}.{name} is public, and missing from the reference"
        if not said(package, name):
            yield f"{package.__name__}.{name} is public, and has no docstring"


def check(app: Any, env: Any) -> None:
    """Stop the build unless every public name is documented."""
    documented = env.domains["py"].objects
    packages = [import_module(name) for name in app.config.reference_packages]
    found = [fault for package in packages for fault in faults(package, documented)]
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
    """Leave out fields whose default is a function: they would be listed as methods."""
    return True if inspect.isfunction(found) and found.__name__ != name else None


def resolve(app: Any, env: Any, node: pending_xref, content: nodes.Node) -> nodes.Node | None:
    """Return a link for a name that a docstring says without its package, or for a field.

    Fields have no place of their own: their class, which lists them, takes their place.
    """
    if node.get("refdomain") != "py":
        return None
    places = homes(app.config.reference_packages)
    *_, owner, name = [node.get("py:class") or "", *node["reftarget"].split(".")]
    page = name if name in places else owner if _public(places, owner, name) else None
    if page is None:
        return None
    target, python = f"{places[page]}.{page}", env.domains["py"]
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, content)


def _public(places: dict[str, str], name: str, member: str = "", *deeper: str) -> bool:
    """Return whether a name is public, or a field or method of a public one."""
    if name not in places or deeper:
        return False
    found = getattr(import_module(places[name]), name)
    return not member or hasattr(found, member) or member in getattr(found, "__annotations__", ())


class Links(SphinxTransform):
    """Makes public names in the prose of Markdown pages links to the reference."""

    default_priority = 400

    def apply(self, **_: Any) -> None:
        """Wrap each literal that is a public name, outside titles and links."""
        places = homes(self.config.reference_packages)
        packages = {package.rpartition(".")[2] for package in places.values()}
        for literal in list(self.document.findall(nodes.literal)):
            found = NAME.fullmatch(literal.astext())
            inside = isinstance(literal.parent, nodes.title | nodes.reference | pending_xref)
            names = found[1].split(".") if found else [""]
            if names[0] in packages and len(names) > 1:  # cr.tasks.LiveMDP
                names = names[1:]
            if inside or not _public(places, *names):
                continue
            target = ".".join([places[names[0]], *names])
            link = pending_xref("", refdomain="py", reftype="obj", reftarget=target)
            link["refdoc"] = self.env.docname
            literal.replace_self(link)
            link += literal


def setup(app: Any) -> dict[str, Any]:
    """Register all this with Sphinx."""
    app.add_config_value("reference_packages", [], "env")
    app.add_transform(Links)
    app.connect("autodoc-process-docstring", explain, priority=600)  # after napoleon's
    app.connect("autodoc-skip-member", skip)
    app.connect("missing-reference", resolve)
    app.connect("env-check-consistency", check)
    return {"parallel_read_safe": True}
