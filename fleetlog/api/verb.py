"""A function behind a command: its arguments are checked as the command's are."""

import functools
import inspect
import sys
from collections.abc import Callable
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


class Verb:
    """A callable with checked arguments.

    ``fill`` adds arguments to those that were given (a file's, say).  ``added`` are options that the function
    does not take itself.
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
            given = self.fill(given)
        for option in known.values():
            if option.default is REQUIRED and option.name not in given:
                raise ArgumentError("is missing", option=option.spelling)
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
    """Check the arguments of a function of the library; its type stays.

    With ``jobs`` it takes ``workers`` and ``scheduler``, which say where its jobs run.
    """
    return lambda function: Verb(function, fill, added=JOBS if jobs else ())  # type: ignore[return-value]
