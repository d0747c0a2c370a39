"""Templates of studies: commented files, and a file for any registered environment."""

from contextlib import closing
from difflib import get_close_matches
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import registry
from gymnasium.spaces import Box, Dict, Discrete

from curricle.errors import ConfigError
from curricle.interop.gymnasium import has_table, is_discrete
from curricle.study_file.own_code import suggestion
from curricle.study_file.schema import unknown

KINDS = {
    "maze": "a maze learnt from its corner",
    "pursuit": "two predators learn to hunt from the values of one",
    "gymnasium": "a slippery lake learnt from one that is not",
    "deep": "a network learns three walls from solved levels of one wall",
}
"""Name of a ready file -> its subject."""


def new_study(kind: str) -> tuple[str, str]:
    """Return the name and the text of a file; ConfigError for an unknown name."""
    if kind in KINDS:
        return f"{kind}.toml", template(kind)
    if kind.isalpha() and kind.islower() and (meant := suggestion(kind, KINDS)):
        raise ConfigError(f"there is no study {kind!r} to start from{meant}")
    name = _known(kind)
    try:
        env = gym.make(name)
    except Exception as error:  # an environment's code may raise any error
        why = " ".join(str(error).split())
        raise ConfigError(f"{name} cannot be made: {type(error).__name__}: {why}") from None
    with closing(env):
        form, parts = _parts(name, env)
    return f"{kind.rpartition(':')[2].replace('/', '-')}.toml", _text(form).format(id=name, **parts)


def template(kind: str) -> str:
    """Return a commented file of one of the :data:`KINDS`, which runs unchanged."""
    if kind not in KINDS:
        raise ConfigError(f"template {kind!r} {unknown(kind, KINDS)}")
    return _text(f"{kind}.toml")


def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


# -- A study of an environment of Gymnasium's registry ---------------------------------------------

SHOWN = 3  # similar ids that a message about an unknown id names
LIMIT = 500  # time limit for environments without a limit


def _known(name: str) -> str:
    """Return the id of an environment (MiniGrid's with its module); ConfigError if unknown."""
    module, colon, _ = name.partition(":")
    if name in registry or (colon and module.isidentifier() and find_spec(module)):
        return name  # gymnasium.make imports the module, which registers its environments
    if find_spec("minigrid"):
        import_module("minigrid")
    if name in registry:
        return f"minigrid:{name}"  # with its module, other processes find it
    lower = {known.lower(): known for known in registry}
    near = get_close_matches(name.lower(), lower, SHOWN, 0.6)
    meant = f", did you mean {' or '.join(lower[known] for known in near)}?" if near else ""
    raise ConfigError(
        f"no environment of Gymnasium's registry is called {name!r}{meant}; curricle new without "
        "a name lists what else there is"
    )


def _parts(name: str, env: Any) -> tuple[str, dict[str, Any]]:
    """Return the form of an environment's study, and the texts that fill it."""
    observed, acting = env.observation_space, env.action_space
    limited = env.spec is not None and env.spec.max_episode_steps is not None
    limited = limited or hasattr(env.unwrapped, "max_steps")
    limit = "" if limited else f"time_limit = {LIMIT}\n"
    minigrid = any(kind.__module__.startswith("minigrid.") for kind in type(env.unwrapped).__mro__)
    if is_discrete(acting) and (is_discrete(observed) or minigrid):
        quick = minigrid or has_table(env)  # other environments are played, a thousand times slower
        budget, seeds, kind = 100_000 if quick else 20_000, 20 if quick else 5, "gymnasium"
        kind = "tabulated" if minigrid else kind
        return "table.txt", {
            "type": kind,
            "seeds": seeds,
            "limit": limit,
            "budget": budget,
            "source_budget": budget // 10,
        }
    if not isinstance(acting, Box | Discrete):
        raise ConfigError(
            f"actions must be numbered, or boxes of numbers, to be learnt: those of {name} are "
            f"{acting}"
        )
    picture = isinstance(observed, Box) and len(observed.shape) == 3
    policy = "CnnPolicy" if picture else "MlpPolicy"
    policy = "MultiInputPolicy" if isinstance(observed, Dict) else policy
    algorithm = "PPO" if isinstance(acting, Box) else "DQN"
    return "network.txt", {"limit": limit, "algorithm": algorithm, "policy": policy}
