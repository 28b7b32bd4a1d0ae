"""The package itself: its program, its exceptions, Ctrl-C, and that the stubs say what the module has."""

import ast
import inspect
import signal
import subprocess
import sys
import time
from importlib import metadata
from pathlib import Path

import pytest

import veiloc
from veiloc import _native

STUBS = Path(veiloc.__file__).with_name("_native.pyi")


def test_the_program_is_there(program):
    assert veiloc.__version__ == metadata.version("veiloc")
    assert program("--version").split() == ["veiloc", veiloc.__version__]
    program("map", "info", "none.vmap", codes=(1,))
    program("map", "paint", codes=(2,))


def test_every_error_is_one_of_ours():
    classes = [c for c in vars(veiloc).values() if isinstance(c, type) and issubclass(c, BaseException)]
    assert len(classes) >= 10 and all(issubclass(c, veiloc.Error) and c.__doc__ for c in classes)
    assert issubclass(veiloc.InputError, ValueError)
    with pytest.raises(veiloc.ServiceError):
        veiloc.Client("http://places.example")
    client = veiloc.Client("http://127.0.0.1:9", retries=0)
    with pytest.raises(veiloc.ServiceError):
        client.profile("hall")


LONG = """
import sys, numpy as np, veiloc
rng = np.random.default_rng(0)
camera = "PINHOLE,640,480,500,500,320,240"
print("begun", flush=True)
try:
    veiloc.estimate_absolute_pose_lines(
        rng.normal(size=(4000, 3)), rng.normal(size=(4000, 3)), camera, {"fixed_iterations": 10**9})
except KeyboardInterrupt:
    print("stopped", flush=True)
"""


def test_ctrl_c_ends_a_long_call():
    # Whoever runs the tests in the background ignores SIGINT, and so would a child, without ever asking the handler.
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    child = subprocess.Popen([sys.executable, "-c", LONG], stdout=subprocess.PIPE, text=True, preexec_fn=heed)
    assert child.stdout.readline() == "begun\n"
    time.sleep(0.5)
    assert child.poll() is None, "it would run for hours"
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate(timeout=20)
    assert out == "stopped\n"


def parameters(function):
    """Names, kinds and defaults as the stub's arguments have them."""
    return [
        (p.name, p.kind is p.KEYWORD_ONLY, p.default is not p.empty)
        for p in inspect.signature(function).parameters.values()
    ]


def of_stub(node):
    a = node.args
    plain = [*a.posonlyargs, *a.args]
    missing = len(plain) - len(a.defaults)
    positional = [(arg.arg, False, i >= missing) for i, arg in enumerate(plain)]
    return positional + [(arg.arg, True, d is not None) for arg, d in zip(a.kwonlyargs, a.kw_defaults)]


def public(names):
    return {name for name in names if not name.startswith("_")}


def test_the_stubs_say_what_the_module_has():
    tree = ast.parse(STUBS.read_text())
    functions = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
    classes = {n.name: n for n in tree.body if isinstance(n, ast.ClassDef)}
    annotated = [n for n in tree.body if isinstance(n, ast.AnnAssign)]
    values = {n.target.id for n in annotated if getattr(n.annotation, "id", "") != "TypeAlias"}
    assert set(functions) | set(classes) | values == public(vars(_native))
    for name, node in functions.items():
        assert of_stub(node) == parameters(getattr(_native, name)), name
        assert getattr(_native, name).__doc__, name
    for name, node in classes.items():
        cls = getattr(_native, name)
        members = {n.name: n for n in node.body if isinstance(n, ast.FunctionDef)}
        fields = {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
        assert public(members) | fields == public(vars(cls)), name
        for member, method in members.items():
            is_property = any(getattr(d, "id", "") == "property" for d in method.decorator_list)
            if member.startswith("_") or is_property:
                continue
            assert getattr(cls, member).__doc__, f"{name}.{member}"
            is_static = any(getattr(d, "id", "") == "staticmethod" for d in method.decorator_list)
            expected = of_stub(method)[0 if is_static else 1 :]
            actual = [p for p in parameters(getattr(cls, member)) if p[0] != "self"]
            assert expected == actual, f"{name}.{member}"


def test_what_is_exported_is_documented():
    assert set(veiloc.__all__) <= set(vars(veiloc))
    for name in public(veiloc.__all__):
        assert getattr(veiloc, name).__doc__, name
    assert STUBS.with_name("py.typed").exists()
