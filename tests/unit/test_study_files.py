"""Every study file that is shipped means what it says: examples and templates are trained."""

import json
import tomllib
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from curricle.study import StudyConfig, read_study
from curricle.study.config import json_schema
from curricle.study.templates import KINDS, template

FOLDER = Path(__file__).parents[2] / "examples"
EXAMPLES = sorted(str(path.relative_to(FOLDER)) for path in FOLDER.rglob("*.toml"))
VALIDATOR = Draft202012Validator(json_schema())
STEPS = 400


@pytest.fixture(params=[*EXAMPLES, *KINDS])
def path(request, tmp_path):
    """A file: an example, or a template as it would be written."""
    if request.param in EXAMPLES:
        return FOLDER / request.param
    (tmp_path / "study.toml").write_text(template(request.param), "utf-8")
    return tmp_path / "study.toml"


def reduced(path):
    """What to set so that a study is trained in no time: tiny budgets and networks."""
    study = tomllib.loads(path.read_text("utf-8"))
    arms = study.get("arms", {})
    network = "n_steps" in str(study.get("learner"))
    small = {"n_steps": 50, "batch_size": 50, "policy_kwargs.net_arch": [8]} if network else {}
    changes = [f"learner.settings.{name}={value}" for name, value in small.items()]
    for name, task in study["tasks"].items():
        changes += [f"tasks.{name}.resets=2"] if task.get("type") == "distilled" else []
        changes += [f"tasks.{name}.evaluation.episodes=1"] if "evaluation" in task else []
        stops = "max_steps" in task["budget"] if isinstance(task.get("budget"), dict) else False
        short = f"{{ max_steps = {STEPS}, min_steps = 0 }}" if stops else STEPS
        changes.append(f"tasks.{name}.budget={short}")
        changes += [f"tasks.{name}.eval_freq={STEPS}"] if "eval_freq" in task else []
    for arm, patch in arms.items():
        for task, patched in patch.get("tasks", {}).items():
            if "budget" in patched:
                changes.append(f"arms.{arm}.tasks.{task}.budget={STEPS}")
    return changes


def test_it_reads_and_comes_back_equal(path):
    study = read_study(path)
    plain = json.loads(json.dumps(study.to_data()))
    assert StudyConfig.from_data(plain, study.folder) == study


@pytest.mark.filterwarnings("ignore:.* take their potential as it is")
def test_it_is_trained(path):
    study = read_study(path, set=reduced(path))
    if '"deep"' in json.dumps(study.to_data()):
        pytest.importorskip("stable_baselines3")
    for arm in study.curricula.values():
        result = arm.train(study.seeds[:1])
        assert (result[arm.target].steps_used == STEPS).all()
        free = [not getattr(arm.tasks[name], "charged", True) for name in arm.ancestors(arm.target)]
        assert (result.source_steps(arm.target) > 0).all() != all(free)


def test_there_are_examples_of_each_kind_of_task():
    assert len(EXAMPLES) >= 6
    kinds = {
        task.get("type", "family")
        for name in EXAMPLES
        for task in tomllib.loads((FOLDER / name).read_text("utf-8"))["tasks"].values()
    }
    tables = {"maze", "crop", "pursuit", "gymnasium", "factory", "family"}
    assert kinds == tables | {"observation_task", "distilled"}


# The schema that editors check files by says the same. This much of JSON Schema it uses:


def test_the_schema_accepts_it(path):
    assert VALIDATOR.is_valid(tomllib.loads(path.read_text("utf-8")))


@pytest.mark.parametrize(
    "change",
    [
        {"sedes": 3},
        {"name": 3},
        {"aggregate": 3},
        {"learner": {"type": "sarsa"}},
        {"learner": {"epsilon": "x"}},
        {"budget": {"epsiodes": 3}},
        {"tasks": {"a": {"type": "maize"}}},
        {"tasks": {"a": {"type": "pursuit", "predatrs": 3}}},
        {"tasks": {"a": {"map": "S.T"}}},
        {"arms": {"a": {"agregate": "mean"}}},
        {"transfers": [{"source": "a"}]},
    ],
)
def test_the_schema_refuses_what_reading_refuses(change):
    study = {"name": "x", "tasks": {"a": {"type": "maze", "map": "S.T"}}}
    assert VALIDATOR.is_valid(study)
    assert not VALIDATOR.is_valid(study | change)
