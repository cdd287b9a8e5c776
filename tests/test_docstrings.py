"""Public names have numpydoc docstrings that agree with their signatures and bodies; their examples run."""

from __future__ import annotations

import ast
import builtins
import doctest
import functools
import importlib
import inspect
import re
import sys
import textwrap
from pathlib import Path

import pytest

import pincontact as pc
from pincontact import view
from pincontact.view import plots

# Sections that are known, as the numpydoc guide orders them.
SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns", "See Also", "Notes", "Examples")
PROPERTIES = (property, functools.cached_property)


def in_package(thing):
    return thing.__module__.partition(".")[0] == pc.__name__


def function_of(member):
    """The function behind a method or property of a class's body, None for other entries."""
    for name in ("fget", "func", "__func__"):
        member = getattr(member, name, member)
    return member if inspect.isfunction(member) else None


def public_members(cls):
    """Public methods and properties of a class's own body."""
    return {name: m for name, m in vars(cls).items() if not name.startswith("_") and function_of(m)}


def annotations(cls):
    """Annotations of public attributes in a class's own body, as they are written."""
    return {name: text for name, text in inspect.get_annotations(cls).items() if not name.startswith("_")}


def handed_out(thing):
    """Annotations of what a function returns, of what an object of a class holds and its methods return."""
    if inspect.isfunction(thing):
        return [thing.__annotations__["return"]]
    calls = [function_of(member) for member in public_members(thing).values()]
    return [*annotations(thing).values(), *(text for call in calls for text in handed_out(call))]


def is_own(thing):
    """Whether a function of `plots` is not from elsewhere."""
    return inspect.isfunction(thing) and thing.__module__ == plots.__name__


def public_names():
    """What `__all__` lists, of the package and of `view`, the plots, and the classes of all that these hand out."""
    names = {name: getattr(module, name) for module in (pc, view) for name in module.__all__}
    names |= {f"plots.{name}": f for name, f in vars(plots).items() if name[0] != "_" and is_own(f)}
    waiting = list(names.values())
    while waiting:
        thing = waiting.pop()
        scope = vars(sys.modules[thing.__module__])
        for word in re.findall(r"\w+", " ".join(handed_out(thing))):
            found = scope.get(word)
            if inspect.isclass(found) and in_package(found) and found not in names.values():
                names[word] = found
                waiting.append(found)
    return names


NAMES = public_names()
CLASSES = {name: thing for name, thing in NAMES.items() if inspect.isclass(thing)}
CALLS = {name: thing for name, thing in NAMES.items() if name not in CLASSES}
CALLS |= {f"{cls}.{name}": member for cls, thing in CLASSES.items() for name, member in public_members(thing).items()}


def each(things):
    return pytest.mark.parametrize("thing", things.values(), ids=things)


def sections(thing):
    """The text of each section of a docstring, that before the first one under ""."""
    parts = re.split(r"^([A-Z]\w*(?: [A-Z]\w*)?)\n-{3,}\n", inspect.getdoc(thing) or "", flags=re.M)
    return {"": parts[0], **dict(zip(parts[1::2], parts[2::2]))}


def entries(thing, title):
    """(names, type, description) of each entry of a section."""
    found = re.findall(r"^(\S[^\n]*)\n?((?:[ \t]+[^\n]*\n?|\n)*)", sections(thing).get(title, ""), re.M)
    heads = [(*head.partition(" : ")[::2], text.strip()) for head, text in found]
    return [(names.split(", "), kind, text) for names, kind, text in heads]


def listed(thing, *titles):
    return [name.lstrip("*") for title in titles for names, *_ in entries(thing, title) for name in names]


def syntax(function):
    return list(ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))))


def raised(function):
    """Names of the errors that a function's body raises; the public base of one that is not public."""
    scope = vars(builtins) | function.__globals__
    raises = [node.exc for node in syntax(function) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)]
    errors = [scope.get(call.func.id) for call in raises if isinstance(call.func, ast.Name)]
    return {
        next(base.__name__ for base in error.__mro__ if not in_package(base) or base in NAMES.values())
        for error in errors
        if inspect.isclass(error)
    }


def parameters(function):
    """Names of a function's parameters and their annotations."""
    known = inspect.signature(function).parameters.values()
    return {p.name: p.annotation for p in known if p.name not in ("self", "cls")}


def is_open(annotation):
    return "Any" in re.split(r"\s*\|\s*", annotation)


def constructor(cls):
    """The constructor that a class's own body has, as source code or as a dataclass."""
    return vars(cls).get("__init__")


def attributes(cls):
    """Public attributes: annotated in the class's body, or set in its constructor or in what that makes (`_make`)."""
    made = constructor(cls)
    found = list(annotations(cls))
    if made is not None and made.__code__.co_filename == inspect.getsourcefile(cls):
        found += [
            node.attr
            for method in (made, vars(cls).get("_make"))
            if method is not None
            for node in syntax(method)
            if isinstance(node, ast.Attribute)
            and isinstance(node.ctx, ast.Store)
            and ast.unparse(node.value) == "self"
            and not node.attr.startswith("_")
        ]
    return found


def check(thing, bodies):
    """What all docstrings have in common; `bodies`: the functions whose errors they name."""
    summary = sections(thing)[""].split("\n")
    assert summary[0].endswith((".", ":")), "the summary is one line, and ends in a full stop"
    assert len(summary) == 1 or not summary[1]
    titles = list(sections(thing))[1:]
    assert titles == sorted(titles, key=SECTIONS.index)
    for names, kind, text in entries(thing, "Parameters") + entries(thing, "Attributes"):
        assert kind or text.startswith("As "), f"{names} have no type"
    for names, kind, _ in [entry for title in SECTIONS[:4] for entry in entries(thing, title)]:
        # of what is returned the name may be left out
        kind = kind or ", ".join(names)
        assert not re.search(r"(?<!\) )\barray(_like)?s?\b(?!,? (shape )?\()", kind), f"{kind} has no shape"
    errors = listed(thing, "Raises")
    assert all(text for *_, text in entries(thing, "Raises")), "an error without its cause"
    assert set().union(*map(raised, bodies)) <= set(errors)
    for name in [*errors, *re.findall(r"\w+Error\b", inspect.getdoc(thing))]:
        assert name in pc.__all__ or hasattr(builtins, name), name


def check_parameters(thing, function):
    """All parameters in their order, none of a type that is left open; those that may be lists are said to be."""
    found = parameters(function)
    assert listed(thing, "Parameters") == list(found)
    assert not [name for name, annotation in found.items() if is_open(annotation) and f"**{name}" not in thing.__doc__]
    for names, kind, text in entries(thing, "Parameters"):
        if any("ArrayLike" in found[name.lstrip("*")].split(" | ") for name in names):
            assert re.search(r"array_like|sequence of", kind) or text.startswith("As "), names


@each(CALLS)
def test_functions_and_methods(thing):
    function = function_of(thing)
    check(thing, [function])
    check_parameters(thing, function)
    if not isinstance(thing, PROPERTIES):
        returns = function.__annotations__["return"] != "None"
        assert bool(entries(thing, "Returns") or entries(thing, "Yields")) == returns


@each(CLASSES)
def test_classes(thing):
    bodies = [vars(thing)[name] for name in ("__init__", "__post_init__") if name in vars(thing)]
    check(thing, [body for body in bodies if body.__code__.co_filename == inspect.getsourcefile(thing)])
    if entries(thing, "Parameters"):
        check_parameters(thing, constructor(thing))
    elif constructor(thing) is not None and not issubclass(thing, Exception):
        # users are given such objects
        assert entries(thing, "Attributes") or not parameters(constructor(thing))
    assert not [name for name, annotation in annotations(thing).items() if is_open(annotation)]
    family = [base for base in thing.__mro__ if in_package(base)]
    known = {name for base in family for name in listed(base, "Parameters", "Attributes")}
    assert set(attributes(thing)) <= known
    assert set(listed(thing, "Attributes")) <= {name for base in family for name in attributes(base)}


MODULES = [importlib.import_module(name) for name in sorted({thing.__module__ for thing in NAMES.values()})]


def test_examples_are_found():
    found = [test for module in MODULES for test in doctest.DocTestFinder().find(module)]
    assert sum(len(test.examples) for test in found) > 150


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_examples_run(module, monkeypatch):
    """In the folder that has the files they open."""
    monkeypatch.chdir(Path(__file__).parents[1])
    assert not doctest.testmod(module).failed
