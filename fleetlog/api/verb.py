"""A function behind a command: its arguments are checked as the command's are."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from fleetlog.api.signature import Option, options_of
from fleetlog.errors import nearest

F = TypeVar("F", bound=Callable[..., Any])
Fill = Callable[[dict[str, Any]], dict[str, Any]]


class Verb:
    """A callable with checked arguments.

    ``fill`` adds arguments to those that were given (a file's, say).  ``added`` are options that the function
    does not take itself; :meth:`run` takes them away and does with them what they are for.
    """

    def __init__(
        self, function: Callable[..., Any], fill: Fill | None = None, name: str = "",
        added: tuple[Option, ...] = (),
    ) -> None:  # fmt: skip
        functools.update_wrapper(self, function)
        self.function, self.fill, self.added = function, fill, added
        self.name = name or function.__name__.rstrip("_")
        own = inspect.signature(function)
        more = [inspect.Parameter(o.name, inspect.Parameter.KEYWORD_ONLY, default=o.default) for o in added]
        self.__signature__ = own.replace(parameters=[*own.parameters.values(), *more])

    @property
    def options(self) -> tuple[Option, ...]:
        """What it asks for."""
        return (*options_of(self.function), *self.added)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Check and convert the arguments, then run the function."""
        return self.run(self.converted(*args, **options))

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
            given = self.fill(given)
        self.__signature__.bind(**given)
        return {name: known[name].convert(value) for name, value in given.items()}

    def __getattr__(self, name: str) -> Any:
        """Return a module of the package of the same name, as ``fleetlog.simulate.engine``."""
        package = sys.modules.get(f"fleetlog.{self.__dict__.get('name')}")
        if package is None or name.startswith("__"):
            raise AttributeError(name)
        return getattr(package, name)

    def __repr__(self) -> str:
        return f"<fleetlog.{self.name}{self.__signature__}>"


def verb(function: F) -> F:
    """Check the arguments of a function of the library; its type stays."""
    return Verb(function)  # type: ignore[return-value]


def filled(fill: Fill) -> Callable[[F], F]:
    """Check the arguments as :func:`verb` does, after ``fill`` has added those that were not given."""
    return lambda function: Verb(function, fill)  # type: ignore[return-value]
