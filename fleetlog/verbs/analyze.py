"""Trips, stops, energy, density, heat maps, chargers of a dataset."""

from functools import cache
from typing import Any

from fleetlog import engines
from fleetlog.api.answer import Answer, destination
from fleetlog.api.inputs import LOADED
from fleetlog.api.verb import JOBS, SHARED, Option, Verb
from fleetlog.core.arguments import Named
from fleetlog.errors import ArgumentError, chosen, nearest
from fleetlog.registry import part, part_lines

PACKAGE = "fleetlog.analysis"
DRAWING = ("matplotlib.backends.backend_agg", "matplotlib.figure", "rerun", "fleetlog.view.results")
OUTPUT = (
    Option("output", None, "Folder to write.", check=Named("PATH", path=True)),
    Option("overwrite", False, SHARED["overwrite"], flag=True),
)


class Analysis(Verb):
    """An analysis as a function of the library: inputs may be paths, the result can be saved and shown."""

    def run(self, given: dict[str, Any]) -> Answer:
        """Answer the question; write the answer to ``output`` where one is given."""
        output, overwrite = given.pop("output", None), given.pop("overwrite", False)
        options = {o.name: o for o in self.options}
        read = [value for name, value in given.items() if options[name].is_path]
        with destination(output, "analysis", overwrite, read) as keep:
            engines.current().ahead = () if output is None else engines.loading(*DRAWING)
            for kind, (_, load) in LOADED.items():
                of_kind = [n for n in given if getattr(options[n].type, "__name__", "") == kind]
                for name in (n for n in of_kind if given[n] is not None):
                    whose = (given["truck"], given["dataset"].site.network) if kind == "Physics" else ()
                    given[name] = load(given[name], *whose)
            return keep(Answer.of(self.function(**given), given["dataset"].site))


class Analyses:
    """Every analysis by its name: ``analyze.density(dataset)``, or ``analyze("density", dataset)``."""

    __name__ = "analyze"

    def __call__(self, name: str, dataset: Any, **options: Any) -> Answer:
        """Answer the question called ``name``."""
        chosen(self.lines(), name, f"no analysis {name!r}", ArgumentError)
        answer: Answer = self.named(name)(dataset, **options)
        return answer

    def __getattr__(self, name: str) -> Analysis:
        if name not in self.lines():
            raise AttributeError(f"no analysis {name!r}; {nearest(name, self.lines())}")
        return self.named(name)

    def __dir__(self) -> list[str]:
        return [*self.lines()]

    @staticmethod
    def lines() -> dict[str, str]:
        """Every analysis with its one line, without importing any."""
        return part_lines(PACKAGE, "")

    @staticmethod
    @cache
    def named(name: str) -> Analysis:
        """The analysis called ``name``, imported when first used."""
        return Analysis(part(PACKAGE, "", name), name=name, added=(*JOBS, *OUTPUT))

    def __repr__(self) -> str:
        return f"<fleetlog.analyze: {', '.join(self.lines())}>"


analyze = Analyses()  # The analyses; see :class:`Analyses`
