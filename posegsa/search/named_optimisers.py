"""The optimisers by the names that a configuration calls them."""

from collections.abc import Callable

from posegsa.config import Experiment, OptimiserName, override
from posegsa.errors import ConfigError
from posegsa.optimisers import (
    GSA,
    Adam,
    AnyOptimiser,
    DifferentialEvolution,
    ParticleSwarm,
    Polish,
    RandomSearch,
)

TITLES: dict[OptimiserName, str] = {
    "gsa": "The gravitational search algorithm",
    "random_search": "Random search",
    "pso": "Particle swarm",
    "de": "Differential evolution",
    "adam": "Gradient descent (Adam)",
    "gsa+adam": "The gravitational search algorithm, then gradient descent (Adam),",
    "cma_es": "CMA-ES (evosax)",
    "evosax": "A strategy of evosax",
    "pycma": "CMA-ES (pycma)",
}
"""The names, and each as the beginning of a sentence."""
_SECTIONS: dict[str, tuple[str, ...]] = {
    "gsa": ("gsa",),
    "random_search": (),
    "pso": ("pso",),
    "de": ("de",),
    "adam": ("adam",),
    "gsa+adam": ("gsa", "adam"),
    "cma_es": ("evosax",),
    "evosax": ("evosax",),
    "pycma": ("pycma",),
}


def make_optimiser(experiment: Experiment) -> AnyOptimiser:
    """The optimiser that an experiment configures.

    All spend agents x iterations evaluations, or as many of them as make whole iterations.

    Raises:
        ConfigError: The optimiser can't run with these settings, or its library is not installed.
    """
    name = experiment.search.optimiser
    try:
        return _MAKERS[name](experiment)
    except (ValueError, ImportError) as error:
        raise ConfigError(f"search.optimiser = {name!r} can't be used: {error}") from None


def size_in_words(experiment: Experiment, between: str = " x ") -> str:
    """Agents and iterations of an experiment's search, such as "100 agents x 250 iterations"."""
    search, parts = experiment.search, []
    if search.optimiser == "gsa+adam":
        both = _gsa_adam(experiment)
        parts = [(both.first.agents, "agent", both.first.iterations, "iteration")]
        parts += [(both.second.agents, "start", both.second.iterations, "step")]
    elif search.optimiser == "adam":
        adam = _adam(experiment)
        parts = [(adam.agents, "start", adam.iterations, "step")]
    else:  # without making it: its library may not be installed where a result is read
        parts = [(search.agents, "agent", search.iterations, "iteration")]
    return ", then ".join(
        f"{agents} {who}{'s' * (agents != 1)}{between}{rounds} {what}{'s' * (rounds != 1)}"
        for agents, who, rounds, what in parts
    )


def specify(experiment: Experiment, text: str, evaluations: int) -> Experiment:
    """The experiment with another optimiser, and settings of its own, at a given budget.

    Args:
        experiment: Where the other settings come from.
        text: A name, as in search.optimiser or "random", and after colons settings of its section,
            or the number of agents: "gsa:g0=1.0", "cma_es:agents=20".
        evaluations: Evaluations of the search; rounded down to whole iterations.

    Raises:
        ConfigError: The name or a setting is not valid, or the budget is below one iteration.
    """
    given, *own = text.split(":")
    name = {"random": "random_search"}.get(given, given)
    if name not in _SECTIONS:
        known = ", ".join(["random", *_SECTIONS])
        raise ConfigError(f"optimiser {given!r} of {text!r}; allowed: {known}")
    settings = [f"search.optimiser={name}"]
    for setting in own:
        key = setting.partition("=")[0].strip()
        of = "search" if key == "agents" else _section(name, key)
        if of is None:
            keys = [k for s in _SECTIONS[name] for k in type(getattr(experiment, s)).model_fields]
            raise ConfigError(f"{key!r} of {text!r}; allowed: {', '.join(['agents', *keys])}")
        settings.append(f"{of}.{setting}")
    changed = override(experiment, settings)
    agents = changed.search.agents
    if evaluations < agents:
        raise ConfigError(
            f"evaluations = {evaluations} of {text!r}; allowed: at least {agents}, one iteration"
        )
    return override(changed, [f"search.iterations={evaluations // agents}"])


def _section(name: str, key: str) -> str | None:
    """The section of an optimiser that has this key."""
    fields = Experiment.model_fields
    for section in _SECTIONS[name]:
        if key in getattr(fields[section].annotation, "model_fields", ()):
            return section
    return None


def _gsa(experiment: Experiment) -> GSA:
    return gsa_of(experiment, experiment.search.iterations)


def gsa_of(experiment: Experiment, iterations: int) -> GSA:
    """The gravitational search that an experiment configures, for so many iterations."""
    settings = experiment.gsa.model_dump()
    if settings["decay_iterations"] == "all":
        settings["decay_iterations"] = None
    return GSA(experiment.search.agents, iterations, **settings)


def _random_search(experiment: Experiment) -> RandomSearch:
    return RandomSearch(experiment.search.agents, experiment.search.iterations)


def _pso(experiment: Experiment) -> ParticleSwarm:
    search = experiment.search
    return ParticleSwarm(search.agents, search.iterations, **experiment.pso.model_dump())


def _de(experiment: Experiment) -> DifferentialEvolution:
    search = experiment.search
    return DifferentialEvolution(search.agents, search.iterations, **experiment.de.model_dump())


def _adam(experiment: Experiment, evaluations: int | None = None) -> Adam:
    search, adam = experiment.search, experiment.adam
    budget = search.agents * search.iterations if evaluations is None else evaluations
    step = adam.starts * adam.gradient_price
    if budget < step:
        raise ValueError(
            f"{budget} evaluations are not enough for one step; allowed: at least {step}, "
            f"adam.starts x adam.gradient_price"
        )
    return Adam(
        adam.starts,
        budget // step,
        learning_rate=adam.learning_rate,
        spread=adam.spread,
        gradient_price=adam.gradient_price,
    )


def _gsa_adam(experiment: Experiment) -> Polish:
    search, share = experiment.search, experiment.adam.share
    iterations = max(1, round(search.iterations * (1 - share)))
    left = search.agents * (search.iterations - iterations)
    return Polish(gsa_of(experiment, iterations), _adam(experiment, left))


def _cma_es(experiment: Experiment) -> AnyOptimiser:
    return _of_evosax(experiment, "CMA_ES")


def _evosax(experiment: Experiment) -> AnyOptimiser:
    return _of_evosax(experiment, experiment.evosax.strategy)


def _of_evosax(experiment: Experiment, strategy: str) -> AnyOptimiser:
    from posegsa.optimisers.evosax import Evosax  # of an extra, which may not be installed

    search = experiment.search
    return Evosax(strategy, search.agents, search.iterations, experiment.evosax.sigma)


def _pycma(experiment: Experiment) -> AnyOptimiser:
    from posegsa.optimisers.pycma import PyCMA

    search = experiment.search
    return PyCMA(search.agents, search.iterations, experiment.pycma.sigma)


_MAKERS: dict[OptimiserName, Callable[[Experiment], AnyOptimiser]] = {
    "gsa": _gsa,
    "random_search": _random_search,
    "pso": _pso,
    "de": _de,
    "adam": _adam,
    "gsa+adam": _gsa_adam,
    "cma_es": _cma_es,
    "evosax": _evosax,
    "pycma": _pycma,
}
