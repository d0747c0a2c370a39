"""Studies to begin with: commented files that are there, and one for any registered environment."""

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
from curricle.study.own_code import suggestion
from curricle.study.schema import unknown

KINDS = {
    "maze": "a maze learnt from its corner",
    "pursuit": "two predators learn to hunt from the values of one",
    "gymnasium": "a slippery lake learnt from one that is not",
    "deep": "a network learns three walls from solved levels of one wall",
}
"""Files that are there, and what they are about."""


def new_study(kind: str) -> tuple[str, str]:
    """Return the name and the text of a file; ConfigError if nothing is called so."""
    if kind in KINDS:
        return f"{kind}.toml", template(kind)
    if kind.isalpha() and kind.islower() and (meant := suggestion(kind, KINDS)):
        raise ConfigError(f"there is no study {kind!r} to start from{meant}")
    name = _known(kind)
    try:
        env = gym.make(name)
    except Exception as error:  # of any kind: an environment is somebody's own code
        why = " ".join(str(error).split())
        raise ConfigError(f"{name} cannot be made: {type(error).__name__}: {why}") from None
    with closing(env):
        form = files(__package__).joinpath("environment.txt").read_text(encoding="utf-8")
        text = form.format(id=name, **_parts(name, env))
    return f"{kind.rpartition(':')[2].replace('/', '-')}.toml", text


def template(kind: str) -> str:
    """Return a commented file of one of the :data:`KINDS` that runs as it is."""
    if kind not in KINDS:
        raise ConfigError(f"template {kind!r} {unknown(kind, KINDS)}")
    return files(__package__).joinpath(f"{kind}.toml").read_text(encoding="utf-8")


# -- A study of an environment of Gymnasium's registry ---------------------------------------------

SHOWN = 3  # ids that are named where one is unknown
STEPS = "# steps, or { episodes = 800 }"
LIMIT = 500  # steps of an episode in an environment that sets no limit of its own
TABLE = """\
[learner]
type = "QLearning"          # or SARSA, ExpectedSARSA, DoubleQLearning
learning_rate = 0.1
epsilon = 0.1

"""
NETWORK = """\
[tasks.target.learner]
type = "deep"
algorithm = "{algorithm}"           # of Stable-Baselines3 or sb3_contrib
policy = "{policy}"
"""


def _known(name: str) -> str:
    """Return the id of an environment, of MiniGrid's with its module; ConfigError if unknown."""
    module, colon, _ = name.partition(":")
    if name in registry or (colon and module.isidentifier() and find_spec(module)):
        return name  # gymnasium.make imports the module, which registers its own
    if find_spec("minigrid"):
        import_module("minigrid")
    if name in registry:
        return f"minigrid:{name}"  # a run in another process finds it by this
    lower = {known.lower(): known for known in registry}
    near = get_close_matches(name.lower(), lower, SHOWN, 0.6)
    meant = f", did you mean {' or '.join(lower[known] for known in near)}?" if near else ""
    raise ConfigError(
        f"no environment of Gymnasium's registry is called {name!r}{meant}; curricle new without "
        "a name lists what else there is"
    )


def _parts(name: str, env: Any) -> dict[str, Any]:
    """Return what the study of an environment says of it."""
    observed, acting = env.observation_space, env.action_space
    limited = env.spec is not None and env.spec.max_episode_steps is not None
    limited = limited or hasattr(env.unwrapped, "max_steps")
    limit = "" if limited else f"time_limit = {LIMIT}\n"
    minigrid = any(kind.__module__.startswith("minigrid.") for kind in type(env.unwrapped).__mro__)
    if is_discrete(acting) and (is_discrete(observed) or minigrid):
        quick = minigrid or has_table(env)  # others are played, a thousand times slower
        budget = 100_000 if quick else 20_000
        return {
            "how": "in a table",
            "note": "",
            "seeds": 20 if quick else 5,
            "learner": TABLE,
            "type": "tabulated" if minigrid else "gymnasium",
            "lines": f"# discount = 0.99\n{limit}{f'budget = {budget:_}':28}{STEPS}\n",
            "source_budget": budget // 10,
            "mapping": "project = {}              # components of the same name correspond",
        }
    if not isinstance(acting, Box | Discrete):
        raise ConfigError(
            f"actions must be numbered, or boxes of numbers, to be learnt: those of {name} are "
            f"{acting}"
        )
    budget, picture = 50_000, isinstance(observed, Box) and len(observed.shape) == 3
    policy = "CnnPolicy" if picture else "MlpPolicy"
    policy = "MultiInputPolicy" if isinstance(observed, Dict) else policy
    algorithm = "PPO" if isinstance(acting, Box) else "DQN"
    return {
        "how": "by a network",
        "note": '# Networks need an extra: pip install "curricle[deep]"\n',
        "seeds": 3,
        "learner": "",
        "type": "observation_task",
        "lines": (
            f"{limit}budget = {budget:_}             # steps\neval_freq = {budget // 20:_}"
            "           # steps between checkpoints\nevaluation = { episodes = 10 }\n\n"
            f"{NETWORK.format(algorithm=algorithm, policy=policy)}"
        ),
        "source_budget": budget // 5,
        "mapping": 'mapping = "identity"      # or observations = "module:function"',
    }
