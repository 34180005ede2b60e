"""Options of a wrong type or name are refused in a sentence that names them: all of them, by their types."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import pgcp
from pgcp.errors import InputError
from pgcp.options import Options, Running

WRONG = {
    "int": ["x", 1.5, True, [1]],
    "str": [3, Path("a"), b"a"],
    "float": ["x", True, [1]],
    "bool": ["yes", 1, 0.0],
    "Path": [3, 1.5, [Path("a")]],
    "Mapping[str,": [3, "x", ["a"], {3: 4}],
}
EVERY = [(kind, field) for kind in (Options, Running) for field in fields(kind) if field.name != "client"]  # see test_probe


def wrong_values(field):
    """Values of other types than a field's."""
    first = str(field.type).split(" ")[0]
    values = ["embed", 3, [3], None] if first.startswith("tuple") else WRONG[first]
    if field.name == "cut":  # a word, or a path
        values = [3, b"a"]
    return values if "None" in str(field.type) else [*values, None]


@pytest.mark.parametrize(("kind", "field"), EVERY, ids=[field.name for _, field in EVERY])
def test_an_option_of_another_type_is_named(kind, field):
    for value in wrong_values(field):
        with pytest.raises(InputError, match=f"^{field.name} is .*, it must be "):
            kind(**{field.name: value})
        if field.name == "own":  # its items are keywords
            continue
        with pytest.raises(InputError, match=f"^{field.name} is .*, it must be "):
            pgcp.parameterize("nowhere.ply", **{field.name: value})


@pytest.mark.parametrize("call", [Options, Running, lambda **named: pgcp.parameterize("nowhere.ply", **named)])
def test_an_unknown_option_is_named_with_the_nearest(call):
    with pytest.raises(InputError, match=r"^unknown option 'zzz'$"):
        call(zzz=3)
    with pytest.raises(InputError, match=r"^unknown option '(patchs|worker)'; did you mean (patches|workers)\?$"):
        call(**{"worker" if call is Running else "patchs": 3})


def test_what_is_as_good_is_taken():
    made = Options(patches=np.int32(3), fix=np.bool_(True), cuts="a/b", repairs=["embed"], seed=2.0)
    assert made == Options(patches=3, fix=True, cuts=Path("a/b"), repairs=("embed",), seed=2)
    assert type(made.patches) is type(made.seed) is int
    assert made.fix is True
    assert pickle.loads(pickle.dumps(made)) == made
    assert replace(made, patches=None).patches is None
    with pytest.raises(InputError, match="unknown option 'patchs'"):
        replace(made, patchs=None)


def test_what_is_no_set_of_options_is_named():
    for name in ("options", "running"):
        with pytest.raises(InputError, match=rf"^{name} is {{'patches': 3}}, it must be of type pgcp\.{name.title()}$"):
            pgcp.compute("nowhere.ply", **{name: {"patches": 3}})
    with pytest.raises(InputError, match=r"^progress is 3, it must be a function"):
        pgcp.parameterize("nowhere.ply", progress=3)
