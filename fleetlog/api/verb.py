"""A function behind a command: its arguments are checked as the command's are."""

import functools
import inspect
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, TypeVar

from fleetlog import engines
from fleetlog.api.signature import REQUIRED, SHARED, Option, options_of
from fleetlog.core.arguments import Between, Named
from fleetlog.errors import ArgumentError, nearest

F = TypeVar("F", bound=Callable[..., Any])
Fill = Callable[[dict[str, Any]], dict[str, Any]]
JOBS = (
    Option("workers", None, SHARED["workers"], check=Between(1, 1024, whole=True)),
    Option("scheduler", None, SHARED["scheduler"], check=Named("ADDRESS")),
)
"""Where jobs run."""


class MissingArgument(TypeError):
    """An argument without a default was not given; ``name`` is its."""

    def __init__(self, verb: str, name: str) -> None:
        self.name = name
        super().__init__(f"{verb}() is missing the argument {name!r}")


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
        """Call the function with checked arguments; its jobs run where ``workers`` and ``scheduler`` say."""
        with on_engine(given):
            return self.function(**given)

    def converted(self, *args: Any, **options: Any) -> dict[str, Any]:
        """Return the given arguments by name, as the function takes them."""
        known = {o.name: o for o in self.options}
        for name in options.keys() - known.keys():
            raise TypeError(f"{self.name}() has no argument {name!r}; {nearest(name, known)}")
        given = self.__signature__.bind_partial(*args, **options).arguments
        if self.fill is not None:
            given = self.fill(given)
        for option in known.values():
            if option.default is REQUIRED and option.name not in given:
                raise MissingArgument(self.name, option.name)
        return {name: known[name].convert(value) for name, value in given.items()}

    def __getattr__(self, name: str) -> Any:
        """Return a module of the package of the same name, as ``fleetlog.simulate.engine``."""
        package = sys.modules.get(f"fleetlog.{self.__dict__.get('name')}")
        if package is None or name.startswith("__"):
            raise AttributeError(name)
        return getattr(package, name)

    def __repr__(self) -> str:
        return f"<fleetlog.{self.name}{self.__signature__}>"


def on_engine(given: dict[str, Any]) -> AbstractContextManager[Any]:
    """Take ``workers`` and ``scheduler`` out of the arguments; jobs of the block run where they say."""
    workers, scheduler = given.pop("workers", None), given.pop("scheduler", None)
    if workers is not None and scheduler is not None:
        raise ArgumentError("--workers and --scheduler do not go together")
    return engines.using(workers, scheduler)


def verb(function: F) -> F:
    """Check the arguments of a function of the library; its type stays."""
    return Verb(function)  # type: ignore[return-value]


def verb_with_jobs(function: F) -> F:
    """Check the arguments as :func:`verb` does; jobs run where ``workers`` and ``scheduler`` say."""
    return Verb(function, added=JOBS)  # type: ignore[return-value]


def filled(fill: Fill) -> Callable[[F], F]:
    """As :func:`verb_with_jobs`, after ``fill`` has added arguments that were not given."""
    return lambda function: Verb(function, fill, added=JOBS)  # type: ignore[return-value]
