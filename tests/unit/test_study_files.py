"""Every study file that is shipped means what it says: examples and templates are trained."""

import json
import tomllib
from pathlib import Path

import pytest

from curricle.study import StudyConfig, read_study
from curricle.study.config.study_config import json_schema
from curricle.study.config.templates import KINDS, template

FOLDER = Path(__file__).parents[2] / "examples"
EXAMPLES = sorted(str(path.relative_to(FOLDER)) for path in FOLDER.rglob("*.toml"))
SCHEMA = json_schema()
STEPS = 400
"""More than ten greedy episodes take, which is what a calibration may spend of them here."""


@pytest.fixture(params=[*EXAMPLES, *KINDS])
def path(request, tmp_path):
    """A file: an example, or a template as it would be written."""
    if request.param in EXAMPLES:
        return FOLDER / request.param
    (tmp_path / "study.toml").write_text(template(request.param), "utf-8")
    return tmp_path / "study.toml"


def reduced(path):
    """What to set so that a study is trained in no time: tiny budgets, short calibrations."""
    study = tomllib.loads(path.read_text("utf-8"))
    arms = study.get("arms", {})
    network = "n_steps" in str(study.get("learner"))
    changes = [f"learner.settings.{of}=50" for of in ("n_steps", "batch_size") if network]
    for name, task in study["tasks"].items():
        stops = "max_steps" in task["budget"] if isinstance(task.get("budget"), dict) else False
        short = f"{{ max_steps = {STEPS}, min_steps = 0 }}" if stops else STEPS
        changes.append(f"tasks.{name}.budget={short}")
        changes += [f"tasks.{name}.eval_freq={STEPS}"] if "eval_freq" in task else []
    for arm, patch in arms.items():
        for task, patched in patch.get("tasks", {}).items():
            if "budget" in patched:
                changes.append(f"arms.{arm}.tasks.{task}.budget={STEPS}")
        edges = patch.get("transfers", {})
        for number, edge in edges.items() if isinstance(edges, dict) else ():
            if edge.get("calibrate"):
                changes.append(f"arms.{arm}.transfers.{number}.calibrate={{ episodes = 1 }}")
    return changes


def test_it_reads_and_comes_back_equal(path):
    study = read_study(path)
    plain = json.loads(json.dumps(study.to_data()))
    assert StudyConfig.from_data(plain, study.folder) == study


def test_its_curricula_have_one_target_and_share_it(path):
    study = read_study(path)
    arms = study.curricula
    targets = [arm.tasks[arm.target] for arm in arms.values()]
    assert all(target is targets[0] for target in targets)


@pytest.mark.filterwarnings("ignore:.* take their potential as it is")
def test_it_is_trained(path):
    study = read_study(path, set=reduced(path))
    solved = '"distilled"' in json.dumps(study.to_data())  # by no step
    if '"deep"' in json.dumps(study.to_data()):
        pytest.importorskip("stable_baselines3")
    for arm in study.curricula.values():
        result = arm.train(study.seeds[:1])
        assert (result[arm.target].steps_used == STEPS).all()
        assert (result.source_steps(arm.target) == 0).all() == solved


def test_there_are_examples_of_each_kind_of_task():
    assert len(EXAMPLES) >= 6
    found = {
        task.get("type", "family")
        for name in EXAMPLES
        for task in tomllib.loads((FOLDER / name).read_text("utf-8"))["tasks"].values()
    }
    tables = {"maze", "crop", "pursuit", "gymnasium", "factory", "family"}
    assert found == tables | {"observation_task", "distilled"}


# The schema that editors check files by says the same. This much of JSON Schema it uses:


def disagreements(value, schema, place=""):
    """What a schema has against a value: places and words."""
    if "$ref" in schema:
        schema = SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]] | schema
    found = []
    if "anyOf" in schema:
        each = [list(disagreements(value, one, place)) for one in schema["anyOf"]]
        found += [] if [] in each else [(place, "none of anyOf", each)]
    if "type" in schema and not is_of_type(value, schema["type"]):
        return [*found, (place, schema["type"], value)]
    if "const" in schema and value != schema["const"]:
        found.append((place, schema["const"], value))
    if "enum" in schema and value not in schema["enum"]:
        found.append((place, schema["enum"], value))
    if isinstance(value, dict):
        found += [
            (place, "required", key) for key in schema.get("required", ()) if key not in value
        ]
        for key, part in value.items():
            inner = schema.get("properties", {}).get(key, schema.get("additionalProperties", True))
            if inner is False:
                found.append((place, "unknown", key))
            elif isinstance(inner, dict):
                found += disagreements(part, inner, f"{place}.{key}")
    if isinstance(value, list):
        prefix = schema.get("prefixItems", [])
        items = [*prefix, *[schema.get("items", {})] * (len(value) - len(prefix))]
        for index, (part, inner) in enumerate(zip(value, items, strict=True)):
            found += disagreements(part, inner, f"{place}[{index}]")
    return found


def is_of_type(value, kind):
    types = {
        "object": dict,
        "array": list,
        "string": str,
        "boolean": bool,
        "integer": int,
        "number": (int, float),
        "null": type(None),
    }
    return isinstance(value, types[kind]) and (kind == "boolean" or not isinstance(value, bool))


def test_the_schema_accepts_it(path):
    assert disagreements(tomllib.loads(path.read_text("utf-8")), SCHEMA) == []


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
    assert disagreements(study, SCHEMA) == []
    assert disagreements(study | change, SCHEMA)
