"""The package: its program, its exceptions, Ctrl-C, and its stubs."""

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


def test_program_is_installed(program):
    assert veiloc.__version__ == metadata.version("veiloc")
    assert program("--version").split() == ["veiloc", veiloc.__version__]
    program("map", "info", "none.vmap", codes=(1,))
    program("map", "paint", codes=(2,))


def test_exception_hierarchy():
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
    # A background test run ignores SIGINT, and child processes inherit that.
    reset_sigint = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    child = subprocess.Popen([sys.executable, "-c", LONG], stdout=subprocess.PIPE, text=True, preexec_fn=reset_sigint)
    assert child.stdout.readline() == "begun\n"
    time.sleep(0.5)
    assert child.poll() is None, "it would run for hours"
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate(timeout=20)
    assert out == "stopped\n"


def parameters(function):
    """Name, keyword-only flag and default flag of each parameter of a function."""
    return [
        (p.name, p.kind is p.KEYWORD_ONLY, p.default is not p.empty)
        for p in inspect.signature(function).parameters.values()
    ]


def stub_parameters(node):
    """The same of a function in the stub."""
    a = node.args
    plain = [*a.posonlyargs, *a.args]
    missing = len(plain) - len(a.defaults)
    positional = [(arg.arg, False, i >= missing) for i, arg in enumerate(plain)]
    return positional + [(arg.arg, True, d is not None) for arg, d in zip(a.kwonlyargs, a.kw_defaults)]


def assert_same_docstring(node, native):
    """IDEs show the docstring of the stub, `help()` that of the Rust source."""
    assert ast.get_docstring(node) == inspect.getdoc(native) is not None, node.name


def public(names):
    return {name for name in names if not name.startswith("_")}


def test_stubs_match_the_module():
    tree = ast.parse(STUBS.read_text())
    functions = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
    # A class with an underscore is a type of the stub only.
    classes = {n.name: n for n in tree.body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")}
    annotated = [n for n in tree.body if isinstance(n, ast.AnnAssign)]
    values = {n.target.id for n in annotated if getattr(n.annotation, "id", "") != "TypeAlias"}
    assert set(functions) | set(classes) | values == public(vars(_native))
    for name, node in functions.items():
        assert stub_parameters(node) == parameters(getattr(_native, name)), name
        assert_same_docstring(node, getattr(_native, name))
    for name, node in classes.items():
        cls = getattr(_native, name)
        assert_same_docstring(node, cls)
        members = {n.name: n for n in node.body if isinstance(n, ast.FunctionDef)}
        fields = {n.target.id for n in node.body if isinstance(n, ast.AnnAssign)}
        assert public(members) | fields == public(vars(cls)), name
        for member, method in members.items():
            is_property = any(getattr(d, "id", "") == "property" for d in method.decorator_list)
            if member.startswith("_"):
                continue
            assert_same_docstring(method, getattr(cls, member))
            if is_property:
                continue
            is_static = any(getattr(d, "id", "") == "staticmethod" for d in method.decorator_list)
            expected = stub_parameters(method)[0 if is_static else 1 :]
            actual = [p for p in parameters(getattr(cls, member)) if p[0] != "self"]
            assert expected == actual, f"{name}.{member}"


def test_exports_are_documented():
    assert set(veiloc.__all__) <= set(vars(veiloc))
    for name in public(veiloc.__all__):
        assert getattr(veiloc, name).__doc__, name
    assert STUBS.with_name("py.typed").exists()


def test_images_in_another_frame_of_a_complete_model_cannot_be_transformed(tmp_path):
    for other_coordinate_frame in ("align", "ignore"):
        with pytest.raises(veiloc.InputError, match="other_coordinate_frame"):
            veiloc.Map.from_colmap(tmp_path, tmp_path, other_coordinate_frame=other_coordinate_frame)


def test_read_posed_recognizes_formats(tmp_path):
    """Posed images of other programs, as `Map.build` takes them."""
    fixtures = Path(__file__).resolve().parents[3] / "crates/tools/mapping/tests/data/importers/poses"
    images, facts = veiloc.read_posed(fixtures / "nerfstudio/transforms.json", tmp_path)
    assert facts["format"] == "nerfstudio's transforms.json" and "applied_transform" in facts["remarks"][0]
    expected, other = veiloc.read_posed(fixtures / "expected/nerfstudio", tmp_path)
    assert other["format"] == "a COLMAP model" and other["down"] is None
    # Without files of these names they stay as written.
    poses = {name.removeprefix("images/"): pose for name, _, pose in images}
    for name, camera, pose in expected:
        degrees, units = poses[name].error(pose)
        assert degrees < 1e-7 and units < 1e-9
        assert camera["width"] == 64
    assert veiloc.read_posed(fixtures / "polycam", tmp_path)[1]["down"] == [0, -1, 0]
    with pytest.raises(veiloc.MapError, match="transforms.json"):
        veiloc.read_posed(tmp_path)
    with pytest.raises(veiloc.MapError, match="pip install pycolmap"):
        veiloc.Map.from_images(tmp_path, tmp_path / "work", python="/nowhere/python")
