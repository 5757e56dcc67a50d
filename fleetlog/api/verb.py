"""A function behind a command: what it asks for, and its arguments checked as the command's are.

Signature and docstring are the one source of commands and pages.  A parameter is described in the section
``Parameters`` of the docstring as ``name : text``; what several share may stand in :data:`SHARED` alone."""

import inspect
import re
import sys
import tomllib
import types
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, update_wrapper
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from fleetlog import engines
from fleetlog.api.inputs import LOADED
from fleetlog.core.arguments import Between, Named, PartOf
from fleetlog.errors import ArgumentError, nearest

F = TypeVar("F", bound=Callable[..., Any])
SHARED = tomllib.loads(Path(__file__).with_name("options.toml").read_text(encoding="utf-8"))
"""Options that several functions have, described once; a docstring of one's own goes first."""
TITLE = r"\n[^\n]+\n-+\n"  # Of a section of a docstring
REQUIRED = inspect.Parameter.empty


@dataclass(frozen=True)
class Option:
    """One argument: ``default`` is :data:`REQUIRED` where there is none, ``many`` a sequence of values."""

    name: str
    default: Any
    help: str
    positional: bool = False
    many: bool = False
    flag: bool = False
    choices: tuple[str, ...] = ()
    check: Callable[[Any], Any] = field(default_factory=Named)
    type: Any = None

    @property
    def spelling(self) -> str:
        """As a command line has it; of a flag that is on by default, what turns it off."""
        word = self.name.replace("_", "-")
        if self.positional:
            return self.name.upper()
        return f"-{word}" if len(word) == 1 else f"--no-{word}" if self.default is True else f"--{word}"

    @property
    def is_path(self) -> bool:
        """Whether it is (also) the name of a file or folder."""
        return bool(getattr(self.check, "path", False))

    def convert(self, value: Any) -> Any:
        """Return what the function takes; :class:`ArgumentError` says what is wrong with the value."""
        if value is None and self.default is None:
            return None
        if self.flag:
            return bool(value)
        if self.many:
            one = replace(self, many=False, default=REQUIRED)
            return tuple(map(one.convert, value if isinstance(value, list | tuple) else (value,)))
        if self.choices and value not in self.choices:
            raise ArgumentError(f"{value!r} is not one of {', '.join(self.choices)}", where=self.spelling)
        try:
            return self.check(value)
        except ValueError as error:
            raise ArgumentError(str(error), where=self.spelling) from None


def _option(parameter: inspect.Parameter, hint: Any, text: str, first: bool) -> Option:
    kind, check = _peeled(hint)
    many = getattr(check, "many", get_origin(kind) is tuple and check is None)
    if get_origin(kind) is tuple:
        kind, inner = _peeled(get_args(kind)[0])
        check = check or inner
    if (loaded := LOADED.get(getattr(kind, "__name__", ""))) is not None:
        check = check or Named(loaded[0], path=True)
    check = check or (Between(whole=kind is int) if kind in (int, float) else Named())
    choices = tuple(get_args(kind)) if get_origin(kind) is Literal else ()
    if isinstance(check, PartOf):
        text = f"{text[:-1]}: {', '.join(check.names())}."
    positional = first and parameter.kind is not parameter.KEYWORD_ONLY
    more = positional, many, kind is bool, choices, check, kind
    return Option(parameter.name, parameter.default, text, *more)


def _peeled(hint: Any) -> tuple[Any, Any]:
    """Return a type without ``Annotated`` and ``| None``, and the check that its annotation carries."""
    if get_origin(hint) is Annotated:
        inner, *more = get_args(hint)
        kind, check = _peeled(inner)
        return kind, next((m for m in more if callable(m)), check)
    some = [a for a in get_args(hint) if a is not type(None)]
    optional = get_origin(hint) in (Union, types.UnionType) and len(some) == 1
    return _peeled(some[0]) if optional else (hint, None)


def parameter_texts(docstring: str | None) -> dict[str, str]:
    """Return the description of every parameter by name, each in one line."""
    section = inspect.cleandoc(docstring or "").partition("\nParameters\n----------\n")[2]
    found: dict[str, str] = {}
    for names, text in re.findall(r"^(\S.*?) : (.*(?:\n +.*)*)", re.split(TITLE, section)[0], re.MULTILINE):
        plain = re.sub("``|:mod:|:func:", "", " ".join(map(str.strip, text.splitlines()))).strip("`")
        named = "." in plain.split(" ")[0].rstrip(".:,")  # a file's name stays as it is
        line = f"{plain[:1] if named else plain[:1].upper()}{plain[1:].rstrip('.')}." if plain else ""
        found |= {name.strip(" *"): line for name in names.split(",")}
    return found


def description(docstring: str | None) -> str:
    """Return a docstring without its sections: what a command's help says first."""
    return re.split(TITLE, inspect.cleandoc(docstring or ""))[0].replace("``", "").strip()


JOBS = (  # Where jobs run
    Option("workers", None, SHARED["workers"], check=Between(1, 1024, whole=True)),
    Option("scheduler", None, SHARED["scheduler"], check=Named("ADDRESS", check=engines.address)),
)
Fill = Callable[[dict[str, Any], dict[str, Option]], dict[str, Any]]


class Verb:
    """A callable with checked arguments; ``fill`` adds some (a file's), ``added`` options are not its own."""

    def __init__(
        self, function: Callable[..., Any], fill: Fill | None = None, name: str = "",
        added: tuple[Option, ...] = (),
    ) -> None:  # fmt: skip
        update_wrapper(self, function)
        self.function, self.fill, self.added = function, fill, added
        self.name = name or function.__name__.rstrip("_")
        own = inspect.signature(function)
        more = [inspect.Parameter(o.name, inspect.Parameter.KEYWORD_ONLY, default=o.default) for o in added]
        self.__signature__ = own.replace(parameters=[*own.parameters.values(), *more])

    @cached_property
    def options(self) -> tuple[Option, ...]:
        """What it asks for, in the order of the function."""
        hints = get_type_hints(inspect.unwrap(self.function), include_extras=True)
        texts = {**SHARED, **parameter_texts(self.function.__doc__)}
        parameters = list(inspect.signature(self.function).parameters.values())
        asked = ((p, hints.get(p.name, Any), texts.get(p.name, "")) for p in parameters)
        return (*(_option(*one, first=one[0] is parameters[0]) for one in asked), *self.added)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Check and convert the arguments, then run the function, its jobs where it was said."""
        given = self.converted(*args, **options)
        workers, scheduler = given.pop("workers", None), given.pop("scheduler", None)
        if workers is not None and scheduler is not None:
            raise ArgumentError("--workers and --scheduler do not go together")
        with engines.using(workers, scheduler):
            return self.run(given)

    def run(self, given: dict[str, Any]) -> Any:
        """Call the function with checked arguments."""
        return self.function(**given)

    def converted(self, *args: Any, **options: Any) -> dict[str, Any]:
        """Return the given arguments by name, as the function takes them."""
        known = {o.name: o for o in self.options}
        for name in options.keys() - known.keys():
            raise TypeError(f"{self.name}() has no argument {name!r}; {nearest(name, known)}")
        given = self.__signature__.bind_partial(*args, **options).arguments
        if self.fill is not None:
            given = self.fill(given, known)
        for option in known.values():
            if option.default is REQUIRED and option.name not in given:
                raise ArgumentError(f"{option.spelling} is missing")
        return {name: known[name].convert(value) for name, value in given.items()}

    def __getattr__(self, name: str) -> Any:
        """Return a module of the package of the same name, as ``fleetlog.simulate.engine``."""
        package = sys.modules.get(f"fleetlog.{self.__dict__.get('name')}")
        if package is None or name.startswith("__"):
            raise AttributeError(name)
        return getattr(package, name)

    def __repr__(self) -> str:
        return f"<fleetlog.{self.name}{self.__signature__}>"


def verb(jobs: bool = False, fill: Fill | None = None) -> Callable[[F], F]:
    """Check the arguments of a function; its type stays.  With ``jobs`` it says where its jobs run."""
    return lambda function: Verb(function, fill, added=JOBS if jobs else ())  # type: ignore[return-value]
