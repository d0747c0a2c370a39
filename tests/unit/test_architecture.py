"""The rules of the layers: all imports point down, stay public, form no cycle."""

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).parents[2] / "src" / "curricle"
LAYERS = [
    *["errors", "arrays", "checks", "text", "progress", "files"],
    *["tasks", "statistics", "planning", "pictures"],
    *["learning", "transfer", "certificate"],
    *["interop", "deep", "curriculum", "candidates", "comparison", "study_file", "study"],
    *["show", "paper", "cli"],
]
"""The packages, each of which imports only from those before it."""
FACE_USERS = {"paper", "cli"}
"""Packages that may import from ``curricle`` itself; `paper` uses public names and no others."""
ROOF = {"", "__main__"}  # curricle/__init__ and __main__: may import anything


class Import(NamedTuple):
    """Module ``source`` imports ``name`` from module ``target`` (names without "curricle.")."""

    source: str
    target: str
    name: str
    line: int

    def __str__(self) -> str:
        return f"{self.source} line {self.line} imports {self.name} from {self.target}"


def module_name(path: Path, package: Path) -> str:
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def source_files(package: Path) -> list[Path]:
    return sorted([*package.rglob("*.py"), *package.rglob("*.pyi")])


def imports_of(path: Path, package: Path, modules: set[str]) -> list[Import]:
    """Every import that ``path`` makes from inside the package, and modules it names as text."""
    source = module_name(path, package)
    home = path.relative_to(package).parent.parts
    imports = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            pairs = [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                up = home[: len(home) - node.level + 1]
                base = ".".join(["curricle", *up, *filter(None, [base])])
            pairs = [(base, alias.name) for alias in node.names]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            target = node.value.removeprefix("curricle.")  # as import_module takes it
            named = target and node.value != target in modules
            named = named and package_of(target) != package_of(source)
            pairs = [(node.value, "")] if named else []
        else:
            continue
        for base, name in pairs:
            top, _, target = base.partition(".")
            if top != "curricle":
                continue
            submodule = f"{target}.{name}".strip(".")
            is_module = submodule in modules  # `from curricle.tasks import mdp`
            imports.append(Import(source, submodule if is_module else target, name, node.lineno))
    return imports


@cache
def all_imports(package: Path) -> tuple[set[str], list[Import]]:
    files = source_files(package)
    modules = {module_name(path, package) for path in files}
    return modules, [entry for path in files for entry in imports_of(path, package, modules)]


def package_of(module: str) -> str:
    """The package of a module."""
    return module.partition(".")[0]


def rank(package: str) -> int:
    """The place of a package in the layers; one without a place is above all others."""
    return LAYERS.index(package) if package in LAYERS else len(LAYERS)


def upward_imports(package: Path) -> list[str]:
    """Imports across packages that do not point down; the facade stands above what it names."""
    imports = []
    for entry in all_imports(package)[1]:
        source, target = package_of(entry.source), package_of(entry.target)
        if source in ROOF or source == target:
            continue
        facade = target == "" and source not in FACE_USERS
        if facade or (target != "" and rank(target) >= rank(source)):
            imports.append(str(entry))
    return imports


def module_imports(package: Path) -> list[str]:
    """Imports of `paper` from a module inside another package, past the names that it offers."""
    return [
        str(entry)
        for entry in all_imports(package)[1]
        if package_of(entry.source) == "paper" != package_of(entry.target) and "." in entry.target
    ]


def private_imports(package: Path) -> list[str]:
    """Imports across packages of a name, or from a module, that starts with one underscore."""

    def private(dotted: str) -> bool:
        return any(p.startswith("_") and not p.endswith("__") for p in dotted.split("."))

    return [
        str(entry)
        for entry in all_imports(package)[1]
        if package_of(entry.source) != package_of(entry.target)
        and private(f"{entry.target}.{entry.name}")
    ]


def import_cycle(package: Path) -> list[str]:
    """The modules of one import cycle; empty if there is none."""
    graph: dict[str, set[str]] = {}
    for entry in all_imports(package)[1]:
        if package_of(entry.source) not in ROOF and entry.source != entry.target:
            graph.setdefault(entry.source, set()).add(entry.target)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_every_package_has_a_place():
    packages = {package_of(module) for module in all_imports(PACKAGE)[0]} - ROOF
    assert packages == set(LAYERS), "give a new package its place in LAYERS and architecture.md"


def test_the_house_is_the_one_that_contributors_read():
    text = (PACKAGE.parents[1] / "docs" / "architecture.md").read_text("utf-8")
    table = re.findall(r"^\| `([\w./`, ]+)` \|", text, re.MULTILINE)
    listed = [name.strip("`/ ").removesuffix(".py") for row in table for name in row.split(",")]
    assert [name for name in listed if name in LAYERS] == LAYERS


def test_imports_point_down():
    assert upward_imports(PACKAGE) == []


def test_imports_across_packages_are_public():
    assert private_imports(PACKAGE) == []


def test_the_paper_uses_public_names():
    assert module_imports(PACKAGE) == []


def test_no_import_cycle():
    assert import_cycle(PACKAGE) == []


# The rules themselves, on small houses built for the purpose.
